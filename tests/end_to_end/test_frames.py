"""Frames of episodes: a camera that shows the target, a heat map on request, and a window where there is a display."""

import dataclasses
import warnings

import gymnasium as gym
import numpy as np
import pytest
from matplotlib import pyplot as plt

from envs.frames import Frames, camera_of
from envs.resect import ResectEnv
from envs.vector import ResectVectorEnv
from gmapspring import render
from gmapspring.rendering.style import Style
from tests.small_scene import small_scene

SCENE = small_scene()
PLAIN = Style(wire=0.0, occlusion=0.0, gloss=0.0)


def separating_cut(env):
    """Play the faces around the target until one is left, and return that one's action."""
    task = env.task
    sides = task.scene.target[task.table.face_tetrahedra]
    *first, last = np.flatnonzero(sides[:, 0] != sides[:, 1]).tolist()
    for action in first:
        env.step(action)
    return last


@pytest.mark.parametrize("corner", range(4))
def test_the_camera_stands_where_the_target_shows(corner):
    # The top cube of each corner of the box in turn; a camera that never turned would miss most of one of them.
    cube = (1, 3, 5, 7)[corner]
    scene = small_scene(target=np.arange(48) // 6 == cube)
    task = ResectEnv(scene).task
    seen = render.pick_faces(task.simulation.body, camera_of(scene), (96, 96))
    seen = seen[seen >= 0] // 4
    assert scene.target[seen].mean() > 0.2
    middle = scene.mesh.points.mean(axis=0)
    aside = scene.mesh.points[scene.mesh.tetrahedra[scene.target]].mean(axis=(0, 1)) - middle
    azimuth = np.radians(camera_of(scene).azimuth)
    assert aside[0] * np.cos(azimuth) + aside[1] * np.sin(azimuth) > 0.0


def test_the_camera_follows_from_mesh_and_target_alone():
    other = dataclasses.replace(SCENE, load=-SCENE.load, certificate=None, young_modulus=2.0 * SCENE.young_modulus)
    assert camera_of(other) == camera_of(SCENE) == camera_of(SCENE)


def test_the_camera_of_a_target_deep_inside_looks_at_the_surface_nearest_to_it():
    mesh = small_scene(cells=(4, 4, 4)).mesh
    centre = mesh.points[mesh.tetrahedra].mean(axis=1)
    inner = np.flatnonzero((np.abs(centre - mesh.points.mean(axis=0)) < 0.009).all(axis=1))
    target = np.zeros(mesh.n_tetrahedra, bool)
    target[inner[np.argmax(centre[inner, 0])]] = True  # not seen, and nearest to the side x+
    camera = camera_of(small_scene(cells=(4, 4, 4), target=target))
    assert np.cos(np.radians(camera.azimuth)) > 0.0


def test_frames_of_strain_differ_from_those_of_tissue_and_have_a_legend():
    frames = {}
    for style in ("tissue", "strain"):
        env = gym.make("envs:Resect-v0", scene=SCENE, render_mode="rgb_array", render_style=style, disable_env_checker=True)
        env.reset(seed=0)
        frames[style] = env.render()
    differs = (frames["tissue"] != frames["strain"]).any(axis=2)
    assert differs[300:, :60].any()  # the legend, where there is no body
    assert differs.mean() > 0.1


def test_rows_draw_what_single_environments_draw_freed_pieces_and_strain_included():
    for style in ("tissue", "strain"):
        single = ResectEnv(SCENE, render_mode="rgb_array", render_style=style)
        batch = ResectVectorEnv(2, SCENE, render_mode="rgb_array", render_style=style)
        single.reset(seed=0)
        batch.reset(seed=0)
        for action in range(3):
            single.step(action)
            batch.step(np.array([action, action + 1]))
        one, other = batch.render()
        np.testing.assert_array_equal(one, single.render())
        assert (one != other).any()


def test_what_a_cut_frees_is_seen_pale_once_and_is_gone_in_the_next_episode():
    env = ResectEnv(SCENE, render_mode="rgb_array")
    env.reset(seed=0)
    start = env.render()
    last = separating_cut(env)
    _, _, terminated, _, info = env.step(last)
    assert terminated and info["reason"] == "separated"
    with_piece = env.render()
    gone = Frames().draw(env.scene, env.task.simulation.body, env.task.strain)
    differs = (with_piece != gone).any(axis=2)
    assert 0.005 < differs.mean() < 0.3
    # Washed out: channels lie closer together than in the target's own colour.
    assert np.ptp(with_piece[differs].astype(float), axis=1).mean() < 60
    env.reset(seed=0)
    np.testing.assert_array_equal(env.render(), start)


def test_without_a_render_mode_nothing_is_remembered_for_frames():
    env = ResectEnv(SCENE)
    env.reset(seed=0)
    env.step(0)
    assert env._frames._before is None


def test_without_a_display_mode_human_says_once_how_to_see_and_plays_on():
    plt.switch_backend("agg")
    env = ResectEnv(SCENE, render_mode="human")
    with pytest.warns(UserWarning, match=r"no display .*agg.* render_mode=\"rgb_array\" .* gmapspring view"):
        env.reset(seed=0)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        _, reward, *_ = env.step(0)
        assert env.render() is None
    plain = ResectEnv(SCENE)
    plain.reset(seed=0)
    assert plain.step(0)[1] == reward
    env.close()
    assert not plt.get_fignums()


def test_a_display_that_cannot_be_reached_is_named(monkeypatch):
    def refuse(*arguments, **named):
        raise RuntimeError("cannot connect to X server\nmore")

    monkeypatch.setattr(plt, "figure", refuse)
    with pytest.warns(UserWarning, match="cannot connect to X server\\), so the episode goes on"):
        ResectEnv(SCENE, render_mode="human").reset(seed=0)


def test_with_a_display_each_reset_and_step_shows_its_frame(monkeypatch):
    shown = []
    plt.switch_backend("agg")
    monkeypatch.setattr(type(plt.figure().canvas), "required_interactive_framework", "fake", raising=False)
    plt.close("all")
    monkeypatch.setattr(plt, "pause", lambda seconds: shown.append((seconds, plt.gca().images[0].get_array().copy())))
    env = ResectEnv(SCENE, render_mode="human")
    env.reset(seed=0)
    env.step(0)
    twin = ResectEnv(SCENE, render_mode="rgb_array")
    twin.reset(seed=0)
    expected = [twin.render(), (twin.step(0), twin.render())[1]]
    assert [seconds for seconds, _ in shown] == [1 / 5] * 2
    for (_, frame), twin_frame in zip(shown, expected, strict=True):
        np.testing.assert_array_equal(frame, twin_frame)
    plt.close("all")  # the window is shut by hand
    env.step(1)
    assert len(shown) == 2
    env.close()


def test_a_state_that_is_gone_back_to_looks_as_it_did():
    env = ResectEnv(SCENE, render_mode="rgb_array")
    env.reset(seed=0)
    for action in SCENE.certificate.order[:-1]:
        env.step(action)
    before, state = env.render(), env.save_state()
    env.step(SCENE.certificate.order[-1])
    freed = env.render()
    assert not np.array_equal(freed, before)
    env.load_state(state)
    np.testing.assert_array_equal(env.render(), before)
