"""Write a scene file of your own, prove that its scenes can be solved, and play one by the proof.

Prints:
    seed 0: 6 cuts free the target at the least cost, 3.0000
    the certificate earns 1.0: separated
"""

import pathlib

import gymnasium as gym

from envs.certify import Rejected, certify
from envs.library import load_scene_config
from envs.scene import build_scene

SCENE = """
name: corner
mesh: {kind: box, cells: [2, 2, 2], spacing: 0.01}
material: {young_modulus: 5000.0, log_scale: 1.0, correlation_length: 0.03}
pinned: {kind: plane, axis: z}
target: {kind: top_cube}
load: {traction: 1000.0, direction: {kind: cone, width: 2.0}}
physics: {density: 1000.0, viscosity: 30.0, settle_seconds: 0.12, initial_settle_seconds: 0.48, integrator: symplectic_euler}
limits: {strain: 0.5, volume_ratio: 0.05, healthy_share: 0.75}
kappa: 0.6
budget: 2.0
splits: {train: {seeds: [0, 100], count: 2}}
"""

path = pathlib.Path("corner.yaml")
path.write_text(SCENE)
config = load_scene_config(path)
certificate = None
for seed in range(10):
    try:
        certificate = certify(config, seed)
    except Rejected as rejection:
        print(f"seed {seed}: no certificate, since {rejection}")
        continue
    print(f"seed {seed}: {len(certificate.order)} cuts free the target at the least cost, {certificate.optimum:.4f}")
    break

# A scene need not come from a file of certificates: the environment takes scenes as they are.
env = gym.make("envs:Resect-v0", scene=build_scene(config, seed, certificate))
env.reset(seed=0)
total = 0.0
for action in certificate.order:
    _, reward, _, _, info = env.step(action)
    total += reward
print(f"the certificate earns {total:.9}: {info['reason']}")
