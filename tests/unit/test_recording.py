"""Recordings: what was done comes back as it was, or not at all; and what frees a target is a demonstration."""

import dataclasses
import json

import numpy as np
import pytest

from agents.recording import RecordingError, fingerprint, place_of, read_recording, write_recording
from agents.session import Session
from envs.library import load_scenes
from envs.resect import ResectEnv
from tests.small_scene import small_scene


def session_on(scenes, split="train", mask="all"):
    """Return a session on some scenes."""
    return Session(ResectEnv(scenes, mask=mask), split, "certificate")


def recorded(scenes, n_cuts=None, index=0, **setting):
    """Return what a session records that follows the certificate, to the end or for some cuts."""
    session = session_on(scenes, **setting)
    session.begin(index)
    for action in session.scene.certificate.order[:n_cuts]:
        session.cut(action)
    return session.recording()


@pytest.fixture(scope="module")
def scene():
    """Return a small scene."""
    return small_scene(0, load=0.02)


@pytest.fixture(scope="module")
def recording(scene):
    """Return a whole episode."""
    return recorded([scene])


def test_a_recording_is_read_as_it_was_written(recording, tmp_path):
    path = tmp_path / "new folder" / "episode.json"
    write_recording(path, recording)
    assert read_recording(path) == recording
    assert recording.reason == "separated" and len(recording.actions) > 1
    assert [each.name for each in path.parent.iterdir()] == ["episode.json"]


def test_a_recording_cut_off_anywhere_is_refused(recording, tmp_path):
    path = tmp_path / "episode.json"
    write_recording(path, recording)
    text = path.read_text()
    for n in range(0, len(text.rstrip()), 7):
        path.write_text(text[:n])
        with pytest.raises(RecordingError, match="is no recording, or only a part of one .* record the episode again"):
            read_recording(path)


@pytest.mark.parametrize(("change", "said"), [
    ({"format": 2}, "format"),
    ({"actions": [1.5]}, r"actions\.0"),
    ({"actions": [-1]}, r"actions\.0"),
    ({"total_return": None}, "total_return"),
    ({"action": []}, "did you mean 'actions'"),
])  # fmt: skip
def test_a_file_of_another_form_is_refused(recording, tmp_path, change, said):
    path = tmp_path / "episode.json"
    path.write_text(json.dumps(recording.model_dump(mode="json") | change))
    with pytest.raises(RecordingError, match=said):
        read_recording(path)


@pytest.mark.parametrize("text", ["[]", "3", '"text"'])
def test_a_file_that_is_no_table_is_refused(tmp_path, text):
    (tmp_path / "episode.json").write_text(text)
    with pytest.raises(RecordingError, match="where keys and values are wanted"):
        read_recording(tmp_path / "episode.json")


def test_a_file_that_is_missing_is_named(tmp_path):
    with pytest.raises(RecordingError, match=r"cannot read .*nowhere\.json: No such file"):
        read_recording(tmp_path / "nowhere.json")


def test_nothing_is_no_recording(scene):
    with pytest.raises(RecordingError, match="nothing has been cut yet"):
        session_on([scene]).recording()


def changed_scenes(scene):
    """Return scenes that each differ from another in one thing that an episode depends on."""
    yield dataclasses.replace(scene, load=scene.load * (1.0 + 1e-6))
    yield dataclasses.replace(scene, young_modulus=np.nextafter(scene.young_modulus, np.inf))
    yield dataclasses.replace(scene, target=np.roll(scene.target, -1))
    yield dataclasses.replace(scene, physics=scene.physics.model_copy(update={"viscosity": 31.0}))
    yield dataclasses.replace(scene, limits=scene.limits.model_copy(update={"strain": 0.6}))
    yield dataclasses.replace(scene, tool_radius=3.0)
    yield dataclasses.replace(scene, budget=3.0)
    yield dataclasses.replace(scene, no_cut=np.roll(scene.target, -12))


def test_a_fingerprint_tells_all_that_an_episode_depends_on(scene):
    assert fingerprint(scene) == fingerprint(dataclasses.replace(scene, certificate=None))
    assert len({fingerprint(scene), *map(fingerprint, changed_scenes(scene))}) == 9


def test_a_recording_of_another_scene_is_refused(recording, scene):
    others = [small_scene(1, load=0.02)]
    with pytest.raises(RecordingError, match="tape shows scene 'small', train seed 0, which is none of the 1 scenes here"):
        place_of(recording, others, "tape")
    renamed = [dataclasses.replace(scene, name="other")]
    with pytest.raises(RecordingError, match="here scene 'other' is played"):
        place_of(recording, renamed, "tape")
    for other in changed_scenes(scene):
        with pytest.raises(RecordingError, match="as it was before it changed; record the episode again"):
            place_of(recording, [other], "tape")
    far = recording.model_copy(update={"actions": (10**6,)})
    with pytest.raises(RecordingError, match="makes the cut 1000000, where there are 0 to"):
        place_of(far, [scene], "tape")
    assert place_of(recording, [*others, scene], "tape") == 1


def test_a_recording_is_played_and_stands_at_its_beginning(recording, scene):
    session = session_on([small_scene(1, load=0.02), scene])
    session.play(recording)
    assert (session.index, session.place, session.n_moments) == (1, 0, len(recording.actions) + 1)
    session.go_to(len(recording.actions))
    assert session.recording() == recording


def test_an_episode_broken_off_can_be_played_and_gone_on_with(scene):
    session = session_on([scene])
    session.play(recorded([scene], 2))
    session.go_to(2)
    assert session.moment.reason is None
    session.follow()
    assert session.moment.actions == scene.certificate.order[:3]


@pytest.mark.parametrize(("change", "said"), [
    ({"total_return": 0.5}, "came to a return of 0.5, separated when it was recorded, and to a return of 1, separated now"),
    ({"reason": "tear"}, "a return of 1, tear when it was recorded"),
    ({"split": "test"}, "the scenes here are of split 'train'"),
])  # fmt: skip
def test_a_recording_that_does_not_come_to_the_same_is_refused(recording, scene, change, said):
    with pytest.raises(RecordingError, match=said):
        session_on([scene]).play(recording.model_copy(update=change))


def test_a_recording_that_makes_a_cut_twice_is_refused(recording, scene):
    first = recording.actions[0]
    with pytest.raises(RecordingError, match=f"tape, cut 2: cutting face {first}, .* is not legal now"):
        session_on([scene]).play(recording.model_copy(update={"actions": (first, first)}), "tape")


# Demonstrations ---------------------------------------------------------------------------------------------------


@pytest.fixture
def cloning():
    """Return what shows recordings to a policy; it needs torch."""
    pytest.importorskip("torch")
    from agents import demonstrations

    return demonstrations


def written(path, recording):
    """Return the name of a file with a recording."""
    write_recording(path, recording)
    return str(path)


def test_a_recorded_episode_shows_what_the_same_certificate_shows(cloning, recording, scene, tmp_path):
    path = written(tmp_path / "episode.json", recording)
    scenes = [small_scene(1, load=0.02), scene]
    shown = cloning.demonstrate_recorded([scenes], [path], "all")
    expected = cloning.demonstrate([scene], "train", "all")
    assert shown.actions.tolist() == expected.actions.tolist() == list(recording.actions)
    for one, other in zip(shown.states, expected.states, strict=True):
        assert all(np.array_equal(part, another) for part, another in zip(one, other, strict=True))


def test_a_shipped_training_scene_is_recorded_and_shown(cloning, tmp_path):
    scenes = load_scenes("box-48", "train")
    paths = [written(tmp_path / f"{index}.json", recorded(scenes, index=index)) for index in (5, 0)]
    shown = cloning.demonstrate_recorded(["box-48"], paths, "all")
    # Side by side: the first cut of each, then the second, and so on.
    orders = [scenes[index].certificate.order for index in (5, 0)]
    places = range(max(map(len, orders)))
    assert shown.actions.tolist() == [order[place] for place in places for order in orders if place < len(order)]


def test_recordings_that_teach_nothing_are_refused(cloning, recording, scene, tmp_path):
    def refused(said, tape, scenes=None, mask="all", kind=cloning.DemonstrationError):
        with pytest.raises(kind, match=said):
            cloning.demonstrate_recorded([scenes or [scene]], [written(tmp_path / "tape.json", tape)], mask)

    refused("seed 0, is not freed by the 2 cuts of .*tape.json, or by fewer: .* record an episode", recorded([scene], 2))
    refused("which training must not see; record a scene of split 'train'", recorded([scene], split="test"))
    refused("which is not trained on", recording, [dataclasses.replace(scene, name="other")])
    refused("before it changed", recording, [dataclasses.replace(scene, load=2.0 * scene.load)], kind=RecordingError)
    refused("makes no cut", recording.model_copy(update={"actions": ()}))
    long = small_scene(0, cells=(2, 2, 4), load=0.02)
    far = recorded_with_a_far_cut(long)
    refused("tape.json, of scene 'small', seed 0, makes a cut that the mask 'focus' forbids", far, [long], "focus")


def recorded_with_a_far_cut(scene):
    """Return an episode that frees the target after a cut that no focus allows."""
    session = session_on([scene])
    focus = ResectEnv(scene, mask="focus")
    focus.reset(seed=0)
    session.cut(int(np.flatnonzero(session.legal & ~focus.action_masks())[0]))
    while not session.moment.is_over:
        session.follow()
    return session.recording()


def test_training_takes_recordings_beside_the_certificates(cloning, tmp_path):
    from agents.training_config import TrainingConfig
    from gmapspring.config import load_config
    from tests.small_run import SMALL, few_scenes, trained

    few = few_scenes(tmp_path)
    scenes = load_scenes(few, "train")
    path = written(tmp_path / "episode.json", recorded(scenes))
    said = []
    trained(tmp_path / "run", n_updates=1, on_text=said.append, scene=few, warm_start={"epochs": 1, "recordings": [path]})
    n_cuts = sum(len(scene.certificate.order) for scene in scenes) + len(scenes[0].certificate.order)
    assert any(text.startswith(f"cloning {n_cuts} cuts") for text in said)
    config = tmp_path / "config.yaml"
    config.write_text(json.dumps(SMALL | {"warm_start": {"recordings": ["episode.json"]}}))
    assert load_config(config, TrainingConfig).warm_start.recordings == [path]
