"""The shipped configuration is found wherever the package lies."""

import importlib.util
import shutil

import pytest

from gmapspring import paths


def load_copy(package):
    """Return the module `paths` as if the package lay in the given folder."""
    package.mkdir(parents=True)
    shutil.copy(paths.__file__, package / "paths.py")
    spec = importlib.util.spec_from_file_location("copy_of_paths", package / "paths.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_configs_are_found_beside_the_package_in_a_clone(tmp_path):
    (tmp_path / "configs").mkdir()
    assert load_copy(tmp_path / "gmapspring").configs_folder() == tmp_path / "configs"


def test_configs_are_found_inside_the_package_of_a_wheel(tmp_path):
    copy = load_copy(tmp_path / "gmapspring")
    (tmp_path / "configs").mkdir()
    (tmp_path / "gmapspring" / "configs").mkdir()
    assert copy.configs_folder() == tmp_path / "gmapspring" / "configs"


def test_a_package_without_configs_says_so(tmp_path):
    with pytest.raises(FileNotFoundError, match="install the package again"):
        load_copy(tmp_path / "gmapspring").configs_folder()


def test_a_file_is_replaced_whole(tmp_path):
    path = tmp_path / "state"
    paths.write_atomically(path, b"old")
    paths.write_atomically(path, b"new")
    assert path.read_bytes() == b"new" and list(tmp_path.iterdir()) == [path]


def test_a_missing_folder_is_named(tmp_path):
    with pytest.raises(FileNotFoundError, match=f"there is no folder {tmp_path / 'none'}$"):
        paths.write_atomically(tmp_path / "none" / "state", b"new")


def test_the_configs_of_this_package_exist():
    assert (paths.configs_folder() / "meshes").is_dir()
