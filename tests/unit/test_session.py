"""Sessions: whoever plays, back and forth, an episode's bits stay those of the environment."""

import numpy as np
import pytest

from agents.page import ViewOptions, open_session, policies_of
from agents.recording import RecordingError, fingerprint, write_recording
from agents.session import Session
from envs.resect import ResectEnv
from gmapspring.errors import ConfigError, StateFileError, TopologyError
from tests.small_scene import small_scene


@pytest.fixture
def session():
    """Return a session on two small scenes."""
    return Session(ResectEnv([small_scene(seed, load=0.02) for seed in (0, 1)]), "train")


def bits(env):
    """Return all that an observer could tell two episodes by."""
    body = env.task.simulation.body
    return (body.nodes.position.tobytes(), body.nodes.velocity.tobytes(), body.gmap.image.tobytes(), env.task.cost,
            env.task.strain.tobytes(), env.n_steps, env.action_masks().tobytes())  # fmt: skip


def straight(session):
    """Return the bits of an environment of its own that makes the same cuts without looking back, and its last observation."""
    env = ResectEnv(list(session.env.scenes))
    observation, _ = env.reset(seed=0, options={"index": session.index})
    for action in session.moment.actions:
        observation, *_ = env.step(action)
    return bits(env), observation


def test_a_plan_is_played_to_the_end_and_comes_to_the_best_return(session):
    for action in session.scene.certificate.order:
        session.cut(action)
    assert session.moment.reason == "separated" and session.moment.is_over
    assert session.moment.total_return == pytest.approx(1.0)  # -0.5 J* / J* + 1.5
    assert not session.legal.any()
    with pytest.raises(TopologyError, match=r"the episode is over \(separated\); undo"):
        session.cut(0)


def test_undo_and_redo_bring_back_every_bit(session):
    seen = [bits(session.env)]
    for action in session.scene.certificate.order[:4]:
        session.cut(action)
        seen.append(bits(session.env))
    assert len(set(seen)) == 5
    for place in (3, 2, 1, 0):
        session.undo()
        assert session.place == place and bits(session.env) == seen[place]
    session.undo()
    assert session.place == 0
    for place in (1, 2, 3, 4, 4):
        session.redo()
        assert session.place == place and bits(session.env) == seen[place]


def test_what_is_cut_after_an_undo_is_what_an_environment_makes_of_the_same_cuts(session):
    first, second, third, *_ = session.scene.certificate.order
    for action in (first, second):
        session.cut(action)
    session.undo()
    session.cut(third)
    assert session.moment.actions == (first, third)
    assert session.n_moments == 3 and session.next_action is None
    there, observation = straight(session)
    assert bits(session.env) == there
    assert all(np.array_equal(session._observation[key], observation[key]) for key in observation)


def test_an_end_can_be_undone(session):
    order = session.scene.certificate.order
    for action in order:
        session.cut(action)
    session.undo()
    assert not session.moment.is_over
    assert session.next_action == order[-1]
    session.cut(order[-1])
    assert session.moment.reason == "separated"


@pytest.mark.parametrize("action", [-1, 10**6])
def test_a_cut_that_there_is_not_changes_nothing(session, action):
    before = bits(session.env)
    with pytest.raises(TopologyError, match="is not legal now"):
        session.cut(action)
    assert bits(session.env) == before and session.place == 0


def test_a_cut_is_made_once(session):
    action = session.scene.certificate.order[0]
    session.cut(action)
    with pytest.raises(TopologyError, match=f"cutting face {action}, between tetrahedra .* is not legal now"):
        session.cut(action)


def test_scenes_follow_each_other_in_a_ring(session):
    seeds = []
    for _ in range(3):
        seeds.append(session.scene.seed)
        session.cut(session.scene.certificate.order[0])
        session.next_scene()
        assert session.moment.actions == ()
    assert seeds == [0, 1, 0]
    with pytest.raises(ConfigError, match="options.index = 2"):
        session.begin(2)


# Motion -----------------------------------------------------------------------------------------------------------


def test_watching_the_body_settle_changes_no_bit(session):
    action = session.scene.certificate.order[0]
    session.cut(action)
    settled = bits(session.env)
    session.show_settling()
    assert session.motion.is_moving and bits(session.env)[:2] != settled[:2]
    session.motion.advance(0.01)
    assert session.motion.is_moving
    session.motion.advance(1.0)
    assert not session.motion.is_moving and bits(session.env) == settled


@pytest.mark.parametrize("command", ["cut", "undo", "hint", "nothing else"])
def test_whatever_is_done_in_the_midst_of_motion_is_done_to_the_settled_body(session, command):
    first, second = session.scene.certificate.order[:2]
    session.cut(first)
    session.show_settling()
    session.motion.advance(0.005)
    session.motion.nudge(session.task, 0.005)
    if command == "cut":
        session.cut(second)
    elif command == "undo":
        session.undo()
    elif command == "hint":
        session.hint()
    else:
        session.motion.end()
    assert bits(session.env) == straight(session)[0]


def test_a_nudge_from_rest_is_seen_and_forgotten(session):
    before = bits(session.env)
    session.motion.nudge(session.task, 0.005)
    assert session.motion.is_shown and bits(session.env) != before
    session.motion.end()
    assert bits(session.env) == before


# Policies ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["random", "min-cut-index", "lookahead", "search:20", "shield:random"])
def test_a_hint_is_legal_and_stays_the_same_until_something_is_done(session, name):
    session.choose_policy(name)
    before = bits(session.env)
    hint = session.hint()
    assert session.legal[hint] and session.hint() == hint
    assert bits(session.env) == before
    assert session.follow() == hint == session.moment.actions[-1]


def test_a_policy_follows_to_the_end(session):
    session.choose_policy("certificate")
    while not session.moment.is_over:
        session.follow()
    assert session.moment.actions == session.scene.certificate.order
    with pytest.raises(TopologyError, match="nothing left to do"):
        session.hint()


def test_a_policy_that_there_is_not_leaves_the_one_before(session):
    with pytest.raises(ConfigError, match=r"there is no policy 'lookahed'; did you mean 'lookahead'\?"):
        session.choose_policy("lookahed")
    assert session.policy_name == "lookahead" and session.legal[session.hint()]


# Snapshots of the environment -------------------------------------------------------------------------------------


def test_a_snapshot_of_another_scene_is_refused(session):
    state = session.env.save_state()
    session.next_scene()
    before = bits(session.env)
    with pytest.raises(StateFileError, match="the state is of scene 'small', seed 0, which is not played now"):
        session.env.load_state(state)
    assert bits(session.env) == before


# What the page opens ----------------------------------------------------------------------------------------------


def test_a_page_opens_the_scene_that_is_asked_for():
    by_index = open_session(ViewOptions(scene="box-48", index=3, mask="focus", policy="rim-first"))
    by_seed = open_session(ViewOptions(scene="box-48", scene_seed=by_index.scene.seed))
    assert fingerprint(by_index.scene) == fingerprint(by_seed.scene) and by_seed.index == 3
    assert (by_index.env.mask_mode, by_index.policy_name, by_index.split) == ("focus", "rim-first", "train")
    names = policies_of(by_index)
    assert names[0] == "rim-first" and len(names) == len(set(names))


@pytest.mark.parametrize(("wrong", "said"), [
    ({"scene": "box-49"}, "there is no scene 'box-49'; did you mean 'box-48'"),
    ({"policy": "lookahed"}, "there is no policy 'lookahed'"),
    ({"policy": "nowhere.zip"}, "cannot read nowhere.zip"),
    ({"split": "tset"}, "no split 'tset'"),
    ({"mask": "focsu"}, "there is no mask 'focsu'"),
    ({"index": 10**6}, "options.index = 1000000"),
    ({"scene_seed": 10**6}, "scene seed 1000000 is none of the 512 scenes here; the nearest is"),
    ({"scene_seed": 0, "index": 0}, "both a scene seed and an index"),
])  # fmt: skip
def test_a_page_of_something_that_there_is_not_is_one_clear_error(wrong, said):
    with pytest.raises(ConfigError, match=said):
        open_session(ViewOptions(**{"scene": "box-48"} | wrong))


def test_a_page_plays_a_recording_with_its_own_scene_split_and_mask(tmp_path):
    made = open_session(ViewOptions(scene="box-48", split="validation", index=2, mask="focus"))
    made.follow()
    made.follow()
    write_recording(tmp_path / "made.json", made.recording())
    shown = open_session(ViewOptions(play=tmp_path / "made.json"))
    assert (shown.split, shown.env.mask_mode, shown.scene.seed) == ("validation", "focus", made.scene.seed)
    assert (shown.place, shown.n_moments) == (0, 3)
    shown.go_to(2)
    assert bits(shown.env) == bits(made.env)
    with pytest.raises(RecordingError, match="the scenes here are of split 'train'"):
        open_session(ViewOptions(play=tmp_path / "made.json", split="train"))
