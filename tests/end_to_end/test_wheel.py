"""The wheel alone, in an empty environment outside the repository: one episode is played, one command run."""

import os
import pathlib
import subprocess
import sys

REPOSITORY = pathlib.Path(__file__).parents[2]

EPISODE = """
import sys
import gymnasium
import gmapspring
env = gymnasium.make("envs:Resect-v0", scene="box-48", split="test")
observation, info = env.reset(seed=1)
rewards, is_over = [], False
while not is_over:
    action = int(observation["action_mask"].argmax())
    observation, reward, terminated, truncated, info = env.step(action)
    rewards.append(reward)
    is_over = terminated or truncated
assert "torch" not in sys.modules and "meshio" not in sys.modules
assert gmapspring.meshes.liver().n_tetrahedra > 1800
print(gmapspring.__file__, len(rewards), info["reason"])
"""


def run(*command, **options):
    """Run a command; show what it printed if it fails."""
    finished = subprocess.run(command, capture_output=True, text=True, timeout=600, **options)
    assert finished.returncode == 0, finished.stdout + finished.stderr
    return finished.stdout


def test_the_wheel_plays_an_episode_in_an_empty_environment(tmp_path):
    run(sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", str(tmp_path / "dist"), str(REPOSITORY))
    (wheel,) = (tmp_path / "dist").glob("*.whl")
    run(sys.executable, "-m", "venv", str(tmp_path / "empty"))
    python = str(tmp_path / "empty" / "bin" / "python")
    run(python, "-m", "pip", "install", "--quiet", "--no-compile", str(wheel))
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    clean = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    words = run(python, "-c", EPISODE, cwd=elsewhere, env=clean).split()
    assert pathlib.Path(words[0]).is_relative_to(tmp_path / "empty")
    assert "gmapspring mesh info" in run(str(tmp_path / "empty" / "bin" / "gmapspring"), "--help", cwd=elsewhere, env=clean)
    assert int(words[1]) >= 1
    assert words[2] in ("separated", "vessel", "tear", "inverted", "volume", "numerical", "budget")
