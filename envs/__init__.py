"""The task: scenes, actions, observations, rewards, and the environments `envs:Resect-v0`, `envs:ResectFlat-v0`, one a level."""

from gymnasium.envs.registration import register, registry

from envs.library import shipped_scenes
from envs.wrappers import FlatObservation

LEVELS = tuple(shipped_scenes())
"""Names of the shipped scenes; `envs:Resect-NAME-v0` plays one of them unless told otherwise."""

if "Resect-v0" not in registry:
    register("Resect-v0", entry_point="envs.resect:ResectEnv", vector_entry_point="envs.vector:ResectVectorEnv")
    register(
        "ResectFlat-v0",
        entry_point="envs.resect:ResectEnv",
        additional_wrappers=(FlatObservation.wrapper_spec(),),
    )
    for level in LEVELS:
        register(
            f"Resect-{level}-v0",
            entry_point="envs.resect:ResectEnv",
            vector_entry_point="envs.vector:ResectVectorEnv",
            kwargs={"scene": level},
        )
