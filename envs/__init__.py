"""The task: scenes, actions, observations, rewards, and the environments `envs:Resect-v0` and `envs:ResectFlat-v0`."""

from gymnasium.envs.registration import register, registry

from envs.wrappers import FlatObservation

if "Resect-v0" not in registry:
    register("Resect-v0", entry_point="envs.resect:ResectEnv", vector_entry_point="envs.vector:ResectVectorEnv")
    register(
        "ResectFlat-v0",
        entry_point="envs.resect:ResectEnv",
        additional_wrappers=(FlatObservation.wrapper_spec(),),
    )
