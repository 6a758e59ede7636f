"""PyBullet: the same tetrahedra as a mass/spring soft body in its deformable world."""

import pathlib
import tempfile

import numpy as np
import pybullet

from tests.benchmarks.bodies import Case, IndexedModel
from tests.benchmarks.timing import Stepper


def prepare(case: Case, model: IndexedModel) -> Stepper:
    """Return the body in PyBullet; its state cannot be put back, so a restart lets it go on."""
    client = pybullet.connect(pybullet.DIRECT)
    pybullet.resetSimulation(pybullet.RESET_USE_DEFORMABLE_WORLD, physicsClientId=client)
    pybullet.setGravity(*case.gravity, physicsClientId=client)
    pybullet.setTimeStep(case.step, physicsClientId=client)
    with tempfile.TemporaryDirectory() as folder:
        path = pathlib.Path(folder) / "body.vtk"
        path.write_text(legacy_vtk(case))
        body = pybullet.loadSoftBody(
            str(path), mass=float(case.material.density * case.mesh.volumes.sum()), useNeoHookean=0, useMassSpring=1,
            useBendingSprings=0, useSelfCollision=0, springElasticStiffness=float(model.stiffness.mean()),
            springDampingStiffness=float(model.damping.mean()), collisionMargin=1e-4, physicsClientId=client,
        )  # fmt: skip
    for node in np.flatnonzero(case.pinned).tolist():
        pybullet.createSoftBodyAnchor(body, node, -1, -1, physicsClientId=client)

    def advance(n_steps: int) -> None:
        for _ in range(n_steps):
            pybullet.stepSimulation(physicsClientId=client)

    def positions() -> np.ndarray:
        return np.array(pybullet.getMeshData(body, -1, flags=pybullet.MESH_DATA_SIMULATION_MESH, physicsClientId=client)[1])

    return Stepper(lambda: None, advance, positions)


def legacy_vtk(case: Case) -> str:
    """Return the mesh in the plain form of VTK's old files that Bullet reads."""
    points, cells = case.mesh.points, case.mesh.tetrahedra
    lines = ["# vtk DataFile Version 2.0", "body", "ASCII", "DATASET UNSTRUCTURED_GRID", f"POINTS {len(points)} double"]
    lines += [" ".join(f"{value:.9g}" for value in point) for point in points]
    lines += [f"CELLS {len(cells)} {5 * len(cells)}"]
    lines += ["4 " + " ".join(map(str, corners)) for corners in cells.tolist()]
    lines += [f"CELL_TYPES {len(cells)}", *["10"] * len(cells)]
    return "\n".join(lines) + "\n"
