"""Scenes: the same seed makes the same bits, and what is made is what the configuration says."""

import pickle

import numpy as np
import pytest

from envs.action_table import action_table, face_pieces
from envs.library import load_scene_config, load_scenes, shipped_scenes
from envs.scene import build_mesh, build_scene, length_unit
from envs.scene_config import SceneConfig
from envs.scene_kinds import FileMesh
from gmapspring.config import check_config, read_yaml
from gmapspring.errors import ConfigError
from gmapspring.mesh import Mesh
from gmapspring.mesh_files import write_mesh
from gmapspring.meshes import box
from gmapspring.paths import configs_folder


def config_with(folder=".", **changes):
    """Return the configuration box-48 with top-level keys replaced."""
    data = read_yaml(configs_folder() / "scenes" / "box-48.yaml")
    return check_config(data | changes, SceneConfig, folder=folder)


def assert_equal_scenes(one, other):
    """Assert that two scenes hold the same bits."""
    assert (one.name, one.seed, one.spacing, one.certificate) == (other.name, other.seed, other.spacing, other.certificate)
    for name in ("target", "pinned", "young_modulus", "load", "anchor"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))


@pytest.mark.parametrize("name", shipped_scenes())
def test_a_shipped_scene_is_named_as_its_file(name):
    assert load_scene_config(name).name == name


def test_the_same_seed_makes_the_same_bits():
    config = load_scene_config("box-108")
    assert_equal_scenes(build_scene(config, 5), build_scene(config, 5))


def test_another_seed_makes_another_scene():
    config = load_scene_config("box-108")
    one, other = build_scene(config, 5), build_scene(config, 6)
    assert not np.array_equal(one.young_modulus, other.young_modulus)
    assert not np.array_equal(one.load, other.load)


def test_a_known_seed_makes_known_numbers():
    # Written down once: if NumPy's generator or our order of draws changes, shipped certificates no longer hold.
    scene = build_scene(load_scene_config("box-108"), 5)
    assert np.flatnonzero(scene.target).tolist() == [102, 103, 104, 105, 106, 107]
    np.testing.assert_array_equal(scene.young_modulus[:3], [5968.463, 6349.399, 6594.121])
    np.testing.assert_allclose(scene.load, [-0.0051556467, -0.0716541808, 0.0695636232], rtol=1e-12)


def test_a_box_is_pinned_at_the_bottom_and_its_target_is_a_cube_at_the_top():
    for seed in range(20):
        scene = build_scene(load_scene_config("box-108"), seed)
        np.testing.assert_array_equal(scene.pinned, scene.mesh.points[:, 2] == 0.0)
        corners = scene.mesh.points[np.unique(scene.mesh.tetrahedra[scene.target])]
        np.testing.assert_allclose(np.ptp(corners, axis=0), scene.spacing)
        assert corners[:, 2].max() == pytest.approx(0.02)
        # six tetrahedra of h^3 / 6 each
        assert scene.mesh.volumes[scene.target].sum() == pytest.approx(scene.spacing**3)


def test_no_target_is_an_anchor():
    for name in ("box-48", "box-108"):
        for seed in range(10):
            scene = build_scene(load_scene_config(name), seed)
            assert scene.target.any()
            assert not (scene.target & scene.anchor).any()


def test_the_load_points_upward_and_is_the_traction_times_the_footprint():
    scene = build_scene(load_scene_config("box-108"), 1)
    # a cube of volume h^3 has the footprint h^2: 1000 Pa * (0.01 m)^2 = 0.1 N
    assert np.linalg.norm(scene.load) == pytest.approx(0.1, rel=1e-8)
    assert scene.load[2] > 0


def test_a_certificate_scales_the_load():
    scenes = load_scenes("box-48", "test")
    scene = scenes[0]
    bare = build_scene(scenes.config, scene.seed)
    np.testing.assert_allclose(scene.load, bare.load * scene.certificate.load_factor, rtol=1e-15)


def test_the_stiffness_varies_by_the_configured_scale():
    logs = [np.log(build_scene(load_scene_config("box-108"), seed).young_modulus / 5000.0) for seed in range(200)]
    # log_scale = 1: over many fields the mean is 0 and the standard deviation 1, up to 1/sqrt(200) or so each
    assert np.mean(logs) == pytest.approx(0.0, abs=0.2)
    assert np.std(logs) == pytest.approx(1.0, abs=0.15)


def test_the_arrays_of_a_scene_are_read_only_also_after_pickling():
    scene = build_scene(load_scene_config("box-48"), 2)
    copy = pickle.loads(pickle.dumps(scene))
    assert_equal_scenes(scene, copy)
    for made in (scene, copy):
        for name in ("target", "pinned", "young_modulus", "load", "anchor"):
            with pytest.raises(ValueError, match="read-only"):
                getattr(made, name)[0] = 0


def test_the_scenes_of_a_configuration_share_one_mesh():
    config = load_scene_config("box-48")
    assert build_scene(config, 1).mesh is build_scene(config, 2).mesh


def test_an_ellipsoid_near_the_top_can_be_the_target():
    config = config_with(mesh={"kind": "box", "cells": [4, 4, 2], "spacing": 0.01}, target={"kind": "ellipsoid", "radius": 1.05})
    for seed in range(10):
        scene = build_scene(config, seed)
        heights = scene.mesh.points[scene.mesh.tetrahedra[scene.target]].mean(axis=1)[:, 2]
        assert len(heights) >= 3
        assert heights.max() > 0.01


def test_an_ellipsoid_that_is_too_small_is_refused_with_its_size():
    config = config_with(target={"kind": "ellipsoid", "radius": 0.1})
    with pytest.raises(ConfigError, match=r"target\.radius = 0\.1 h \(0\.001 m\) gave fewer than 6"):
        build_scene(config, 0)


def test_a_users_own_mesh_file_with_named_regions_makes_a_scene(tmp_path):
    plain = box((2, 2, 2), spacing=0.02)
    lump = np.arange(plain.n_tetrahedra) // 6 == 7
    left = plain.points[:, 0] == 0.0
    write_mesh(tmp_path / "organ.vtu", Mesh(plain.points, plain.tetrahedra, {"lump": lump}, {"left": left}))
    config = config_with(
        folder=tmp_path,
        name="organ",
        mesh={"kind": "file", "path": "organ.vtu"},
        target={"kind": "region", "name": "lump"},
        pinned={"kind": "region", "name": "left"},
        load={"traction": 500, "direction": {"kind": "fixed", "vector": [0, 3, 4]}},
    )
    scene = build_scene(config, 0)
    np.testing.assert_array_equal(scene.pinned, left)
    np.testing.assert_array_equal(scene.target, lump & ~left[plain.tetrahedra].any(axis=1))
    np.testing.assert_allclose(scene.load / np.linalg.norm(scene.load), [0.0, 0.6, 0.8])
    assert scene.spacing == pytest.approx(0.02)


def test_a_region_that_the_mesh_lacks_is_refused_with_those_it_has(tmp_path):
    plain = box((2, 2, 2), spacing=0.02)
    write_mesh(tmp_path / "organ.vtu", Mesh(plain.points, plain.tetrahedra, {"lump": np.arange(48) < 6}))
    config = config_with(
        folder=tmp_path,
        mesh={"kind": "file", "path": "organ.vtu"},
        target={"kind": "region", "name": "tumour"},
    )
    with pytest.raises(ConfigError, match="no region 'tumour'; it has lump"):
        build_scene(config, 0)


def test_a_cube_cannot_be_the_target_in_a_mesh_file():
    with pytest.raises(ConfigError, match="needs mesh.kind 'box'"):
        config_with(mesh={"kind": "file", "path": "organ.vtu"})


def test_seeds_of_two_splits_may_not_overlap():
    splits = {"train": {"seeds": [0, 100], "count": 3}, "test": {"seeds": [99, 200], "count": 3}}
    with pytest.raises(ConfigError, match="splits: the seeds of train and test overlap"):
        config_with(splits=splits)


def test_the_unit_of_length_of_a_file_is_the_cube_of_six_mean_tetrahedra(tmp_path):
    write_mesh(tmp_path / "cubes.vtu", box((3, 1, 1), spacing=0.03))
    source = FileMesh(kind="file", path=str(tmp_path / "cubes.vtu"))
    assert build_mesh(source).n_tetrahedra == 18
    assert length_unit(source) == pytest.approx(0.03, rel=1e-6)


def test_a_scene_that_does_not_exist_gets_a_hint():
    with pytest.raises(ConfigError, match="no scene 'box-106'; did you mean 'box-108'"):
        load_scene_config("box-106")


def test_a_split_that_does_not_exist_gets_a_hint():
    with pytest.raises(ConfigError, match="no split 'tset'; did you mean 'test'"):
        load_scenes("box-48", "tset")


# Other rules --------------------------------------------------------------------------------------------------------

BOX = {"kind": "box", "cells": [4, 4, 2], "spacing": 0.01}
ELLIPSOID = {"kind": "ellipsoid", "radius": 1.05}


def beside_by_hand(mesh, tets):
    """Return tetrahedra that have three points in common with one of some, those themselves included."""
    corners = [set(row) for row in mesh.tetrahedra.tolist()]
    return {tet for tet in range(mesh.n_tetrahedra) if any(len(corners[tet] & corners[other]) >= 3 for other in tets)}


@pytest.mark.parametrize("seed", range(12))
def test_a_channel_leads_from_the_pinned_plane_up_beside_the_target_and_changes_nothing_else(seed):
    scene = build_scene(config_with(mesh=BOX, target=ELLIPSOID, no_cut={"kind": "channel"}), seed)
    plain = build_scene(config_with(mesh=BOX, target=ELLIPSOID), seed)
    assert_equal_scenes(scene, plain)
    assert not plain.vessel.any()
    vessel, target = set(np.flatnonzero(scene.vessel).tolist()), set(np.flatnonzero(scene.target).tolist())
    assert face_pieces(action_table(scene.mesh), scene.vessel).max() == 0
    around = beside_by_hand(scene.mesh, target)
    assert not vessel & around
    assert beside_by_hand(scene.mesh, vessel) & around
    assert scene.pinned[scene.mesh.tetrahedra[sorted(vessel)]].sum(axis=1).max() == 3
    assert (scene.vessel & scene.anchor).any() and (scene.vessel & ~scene.anchor).any()


def test_the_channel_of_a_seed_is_always_the_same_and_of_another_another():
    config = config_with(mesh=BOX, target=ELLIPSOID, no_cut={"kind": "channel"})
    one, again, other = (build_scene(config, seed).vessel for seed in (3, 3, 4))
    np.testing.assert_array_equal(one, again)
    assert not np.array_equal(one, other)


@pytest.mark.parametrize("seed", range(12))
def test_several_ellipsoids_have_no_face_in_common(seed):
    scene = build_scene(config_with(mesh=BOX | {"cells": [6, 4, 2]}, target=ELLIPSOID | {"count": 2}), seed)
    pieces = face_pieces(action_table(scene.mesh), scene.target)
    assert pieces.max() >= 1
    for piece in range(pieces.max() + 1):
        members = np.flatnonzero(pieces == piece).tolist()
        assert not beside_by_hand(scene.mesh, members) & set(np.flatnonzero(scene.target & (pieces != piece)).tolist())


def test_ellipsoids_without_room_for_all_are_refused():
    with pytest.raises(ConfigError, match=r"target\.count = 9: ellipsoids of radius 1\.05 h overlapped or touched"):
        build_scene(config_with(mesh=BOX, target=ELLIPSOID | {"count": 9}), 0)


def test_named_regions_of_a_file_can_be_targets_together_and_a_vessel(tmp_path):
    plain = box((2, 2, 2), spacing=0.02)
    cube_of = np.arange(plain.n_tetrahedra) // 6
    regions = {"one": cube_of == 1, "two": cube_of == 7, "vein": (cube_of == 4) | (cube_of == 7)}
    write_mesh(tmp_path / "organ.vtu", Mesh(plain.points, plain.tetrahedra, regions))
    values = dict(folder=tmp_path, mesh={"kind": "file", "path": "organ.vtu"})
    vein = {"kind": "region", "name": "vein"}
    scene = build_scene(config_with(target={"kind": "region", "names": ["one", "two"]}, no_cut=vein, **values), 0)
    np.testing.assert_array_equal(scene.target, regions["one"] | regions["two"])
    np.testing.assert_array_equal(scene.vessel, cube_of == 4)
    with pytest.raises(ConfigError, match=r"no_cut\.name: the mesh has no region 'vain'; it has one, two, vein"):
        build_scene(config_with(target={"kind": "region", "name": "one"}, no_cut=vein | {"name": "vain"}, **values), 0)


@pytest.mark.parametrize("target", [{"name": "one", "names": ["two"]}, {}, {"names": []}])
def test_a_region_target_is_named_in_one_way(target):
    with pytest.raises(ConfigError, match="give either name, or names"):
        config_with(target={"kind": "region", **target}, mesh={"kind": "file", "path": "organ.vtu"})


def test_a_channel_needs_a_box_on_a_plane():
    with pytest.raises(ConfigError, match=r"no_cut\.kind 'channel' needs mesh\.kind 'box' and pinned\.kind 'plane'"):
        config_with(no_cut={"kind": "channel"}, pinned={"kind": "region", "name": "left"})
