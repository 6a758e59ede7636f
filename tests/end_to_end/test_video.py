"""Videos: the episode in them is the episode without them, and the files are what their names say."""

import importlib
import io

import numpy as np
import pytest
from PIL import Image

from agents import video
from agents.choice import make_policy
from agents.evaluation import play_episode
from agents.film import PARTS, Filmed
from agents.video import Player, caption, record_video
from envs.frames import Frames
from envs.resect import ResectEnv
from gmapspring.errors import ConfigError
from tests.small_scene import small_scene

SCENES = [small_scene(seed) for seed in (0, 1)]


def player(name, scenes=SCENES):
    """Return a player on an environment of its own."""
    env = ResectEnv(scenes)
    return Player(name, make_policy(name, env, 0), env)


@pytest.fixture(autouse=True)
def small_pictures(monkeypatch):
    """Draw small: what is tested does not depend on the size."""
    monkeypatch.setattr(video, "SIDE", 96)


class Recorder:
    """A policy that does what another does and keeps what it saw."""

    def __init__(self, policy):
        self.policy, self.seen = policy, []

    def predict(self, observation, *arguments, **named):
        self.seen.append({name: part.tobytes() for name, part in observation.items()})
        return self.policy.predict(observation, *arguments, **named)


@pytest.mark.parametrize("name", ["min-cut-random", "shield:rim-first", "random"])
def test_a_filmed_episode_is_bit_for_bit_the_one_that_is_not(name):
    plays = []
    for is_filmed in (False, True):
        env = ResectEnv(SCENES)
        recorder = Recorder(make_policy(name, env, 0))
        filmed = Filmed(env, Frames(size=(32, 32)))
        episode = play_episode(recorder, filmed if is_filmed else env, name, 3, 1)
        end = env.task.simulation.body.nodes
        plays.append((recorder.seen, episode._replace(seconds=0.0), end.position.tobytes(), end.velocity.tobytes()))
    assert plays[0] == plays[1]


def test_every_cut_has_its_frames_and_the_last_is_the_episodes_own():
    env = ResectEnv(SCENES)
    filmed = Filmed(env, Frames(size=(64, 64)))
    filmed.reset(seed=0)
    action = int(np.flatnonzero(env.action_masks())[-1])
    filmed.step(action)
    reel = filmed.reel
    assert len(reel.frames) == len(reel.captions) == 1 + PARTS
    np.testing.assert_array_equal(
        reel.frames[-1], Frames(size=(64, 64)).draw(env.scene, env.task.simulation.body, env.task.strain)
    )
    assert reel.captions[0] == "0 cuts, cost 0.00 J*"
    assert reel.captions[-1].startswith("1 cut, cost ")
    # The body is seen on its way: no two frames of the cut are the same.
    assert len({frame.tobytes() for frame in reel.frames[1:]}) == PARTS


def test_an_illegal_action_is_filmed_as_one_frame():
    env = ResectEnv(SCENES)
    filmed = Filmed(env, Frames(size=(32, 32)))
    filmed.reset(seed=0)
    filmed.step(int(np.flatnonzero(~env.action_masks())[0]))
    assert len(filmed.reel.frames) == 2 and filmed.reel.captions[-1].endswith("illegal")


@pytest.mark.parametrize(("ending", "kind"), [("gif", "GIF"), ("webp", "WEBP")])
def test_two_policies_stand_side_by_side_in_a_moving_picture(tmp_path, ending, kind):
    path = tmp_path / "new" / f"film.{ending}"
    episodes = record_video([player("rim-first"), player("min-cut-random")], path, indices=(0,))
    assert [episode.policy for episode in episodes] == ["rim-first", "min-cut-random"]
    with Image.open(path) as film:
        assert film.format == kind and film.n_frames > PARTS
        assert film.size == (2 * video.SIDE, video.SIDE + video.STRIP)
    assert [file.name for file in path.parent.iterdir()] == [path.name]


def test_the_same_episodes_give_the_same_bytes(tmp_path):
    contents = []
    for name in ("one.gif", "two.gif"):
        record_video([player("rim-first", SCENES[:1])], tmp_path / name)
        contents.append((tmp_path / name).read_bytes())
    assert contents[0] == contents[1]


def test_a_gif_shows_each_pixel_within_what_its_palette_can():
    random = np.random.default_rng(0)
    first = np.zeros((20, 30, 3), np.uint8) + np.array([200, 40, 40], np.uint8)
    second = first.copy()
    second[5:15, 5:15] = 40, 160, 180
    third = np.clip(second.astype(int) + random.integers(-3, 4, second.shape), 0, 255).astype(np.uint8)
    with Image.open(io.BytesIO(video.as_gif([first, second, third]))) as film:
        for place, expected in enumerate((first, second)):
            film.seek(place)
            assert np.abs(np.asarray(film.convert("RGB")).astype(int) - expected).max() <= 6 + video.UNSEEN


def test_text_that_is_too_long_loses_its_front():
    narrow, wide = (caption("runs/a-very-long-name/best.zip", "1 cut", width) for width in (120, 480))
    assert narrow.shape == (video.STRIP, 120, 3) and wide.shape == (video.STRIP, 480, 3)
    assert (narrow[:, -8:] == 255).all()
    assert video.fitting("abcdef", len, 5) == "...ef" and video.fitting("abc", len, 5) == "abc"


@pytest.mark.parametrize(
    ("name", "n_players", "message"),
    [("film.avi", 1, r"ending must be one of \.gif, \.webp, \.mp4"), ("film.gif", 0, "1 to 4 policies"),
     ("film.gif", 5, "not 5")],
)  # fmt: skip
def test_what_cannot_be_filmed_is_said_before_anything_is_played(tmp_path, name, n_players, message):
    with pytest.raises(ConfigError, match=message):
        record_video([None] * n_players, tmp_path / name)
    assert not list(tmp_path.iterdir())


def test_an_mp4_without_its_package_says_what_to_install(tmp_path, monkeypatch):
    def refuse(name, *arguments):
        raise ImportError(name)

    monkeypatch.setattr(importlib, "import_module", refuse)
    with pytest.raises(ConfigError, match=r'pip install "gmapspring\[video\]"'):
        record_video([None], tmp_path / "film.mp4")


def test_an_mp4_is_written_where_its_package_is_there(tmp_path):
    pytest.importorskip("imageio_ffmpeg")
    path = tmp_path / "film.mp4"
    record_video([player("rim-first")], path)
    assert path.read_bytes()[4:8] == b"ftyp"
