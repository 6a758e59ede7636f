"""MuJoCo: the same tetrahedra as a flex, stepped by its own RK4."""

import mujoco
import numpy as np

from tests.benchmarks.bodies import Case, IndexedModel
from tests.benchmarks.timing import Stepper

SCENE = """
<mujoco>
  <option timestep="{step}" integrator="RK4" gravity="{gravity}"><flag contact="disable" constraint="disable"/></option>
  <size memory="1G"/>
  <worldbody>
    <flexcomp name="body" type="direct" dim="3" mass="{mass}" radius="1e-6" point="{points}" element="{elements}">
      <contact contype="0" conaffinity="0" selfcollide="none"/>
      <elasticity young="{young}" poisson="0.25" damping="{damping}"/>
      <pin id="{pinned}"/>
    </flexcomp>
  </worldbody>
</mujoco>
"""


def prepare(case: Case, model: IndexedModel) -> Stepper:
    """Return the body in MuJoCo, float64."""
    text = SCENE.format(
        step=case.step,
        gravity=_text(np.array(case.gravity)),
        mass=float(case.material.density) * case.mesh.volumes.sum(),
        points=_text(case.mesh.points),
        elements=_text(case.mesh.tetrahedra),
        young=float(case.material.young_modulus),
        damping=float(case.material.damping),
        pinned=_text(np.flatnonzero(case.pinned)),
    )
    physics = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(physics)
    mujoco.mj_forward(physics, data)
    return Stepper(
        restart=lambda: mujoco.mj_resetData(physics, data),
        advance=lambda n_steps: mujoco.mj_step(physics, data, nstep=n_steps),
        positions=lambda: data.flexvert_xpos.reshape(-1, 3),
    )


def _text(values: np.ndarray) -> str:
    """Return numbers as an XML attribute."""
    return " ".join(f"{value:.9g}" for value in np.ravel(values))
