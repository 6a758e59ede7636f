"""Configuration files: strict, and every mistake reported at once."""

from typing import Annotated, Literal

import pytest
from pydantic import Field, PositiveFloat

from envs.scene_config import SceneConfig
from gmapspring.config import Config, check_config, closest, load_config, read_yaml
from gmapspring.errors import ConfigError
from gmapspring.paths import configs_folder


class Round(Config):
    kind: Literal["round"]
    radius: PositiveFloat


class Square(Config):
    kind: Literal["square"]
    side: PositiveFloat


class Drawing(Config):
    title: str = "untitled"
    shapes: list[Annotated[Round | Square, Field(discriminator="kind")]]
    size: tuple[int, int]
    margin: PositiveFloat | None = None
    named: dict[str, Round] = {}


GOOD = {"shapes": [{"kind": "round", "radius": 1.0}], "size": [3, 4]}


def mistakes_of(data, model=Drawing):
    """Return the lines that name mistakes."""
    with pytest.raises(ConfigError) as caught:
        check_config(data, model)
    return [line.strip() for line in str(caught.value).splitlines()[1:]]


def write(tmp_path, text):
    """Return a new file with the text."""
    path = tmp_path / "some.yaml"
    path.write_text(text)
    return path


def test_a_good_configuration_is_read_with_its_defaults():
    drawing = check_config(GOOD, Drawing)
    assert drawing.size == (3, 4)
    assert drawing.title == "untitled"
    assert drawing.shapes == [Round(kind="round", radius=1.0)]


def test_a_configuration_cannot_be_changed_afterwards():
    with pytest.raises(ValueError, match="frozen"):
        check_config(GOOD, Drawing).title = "other"


def test_all_mistakes_are_reported_at_once_with_dotted_paths():
    data = {
        "titel": "a",
        "shapes": [{"kind": "round", "radius": -1.0}, {"kind": "squre", "side": 2.0}, {"kind": "square"}],
        "size": [3, "4"],
        "named": {"sun": {"kind": "round", "radius": 1.0, "radios": 2.0}},
    }
    assert mistakes_of(data) == [
        "named.sun.radios: unknown key; did you mean 'radius'?",
        "shapes.0.radius: input should be greater than 0 (got -1.0)",
        "shapes.1: 'squre' is not one of 'round', 'square'; did you mean 'square'?",
        "shapes.2.side: missing",
        "size.1: input should be a valid integer (got '4')",
        "titel: unknown key; did you mean 'title'?",
    ]


def test_a_misspelt_key_is_reported_once_and_not_again_as_missing():
    assert mistakes_of({"shapes": [{"kind": "round", "radius": 1.0}], "sise": [3, 4]}) == [
        "sise: unknown key; did you mean 'size'?"
    ]


def test_a_key_that_resembles_nothing_gets_the_list_of_keys():
    [line] = mistakes_of(GOOD | {"qqq": 1})
    assert line == "qqq: unknown key; known are margin, named, shapes, size, title"


@pytest.mark.parametrize("value", ["3.0", True, None, float("nan"), float("inf")])
def test_nothing_is_silently_converted_to_a_number(value):
    [line] = mistakes_of(GOOD | {"shapes": [{"kind": "round", "radius": value}]})
    assert line.startswith("shapes.0.radius: ")


def test_a_missing_kind_is_reported_as_such():
    assert mistakes_of(GOOD | {"shapes": [{"radius": 1.0}]}) == ["shapes.0: the key 'kind' is missing"]


def test_data_that_is_no_mapping_is_refused():
    with pytest.raises(ConfigError, match="keys and values"):
        check_config(["a"], Drawing)


def test_the_message_names_the_file_and_counts_the_mistakes(tmp_path):
    path = write(tmp_path, "shapes: []\nsize: [1, 2, 3]\nmargin: -1.0\n")
    with pytest.raises(ConfigError) as caught:
        load_config(path, Drawing)
    assert str(caught.value).startswith(f"{path} has 2 mistakes:\n")


def test_a_number_in_scientific_notation_is_a_number(tmp_path):
    # YAML 1.1 as PyYAML reads it takes 5e3 for text: the dot is missing.
    data = read_yaml(write(tmp_path, "a: 5e3\nb: -1E-2\nc: 1.5e+3\nd: e5\n"))
    assert data == {"a": 5000.0, "b": -0.01, "c": 1500.0, "d": "e5"}


def test_a_key_given_twice_is_refused_with_its_line(tmp_path):
    with pytest.raises(ConfigError, match="line 3: the key 'size' is given twice"):
        read_yaml(write(tmp_path, "size: 1\nother: 2\nsize: 3\n"))


def test_broken_yaml_is_refused_with_its_line(tmp_path):
    with pytest.raises(ConfigError, match=r"some\.yaml, line 2"):
        read_yaml(write(tmp_path, "a: 1\nb: [1, 2]]\n"))


def test_a_file_that_is_not_there_is_named(tmp_path):
    with pytest.raises(ConfigError, match="cannot read .*nowhere.yaml: No such file"):
        load_config(tmp_path / "nowhere.yaml", Drawing)


def test_a_binary_file_is_refused(tmp_path):
    path = tmp_path / "some.yaml"
    path.write_bytes(b"\xff\xfe\x00\x81")
    with pytest.raises(ConfigError, match="cannot read"):
        read_yaml(path)


def test_hints_ignore_case_and_fall_back_to_the_list():
    assert closest("RK4", ["rk4", "symplectic_euler"]) == "did you mean 'rk4'?"
    assert closest("zzz", ["b", "a"]) == "known are a, b"
    assert closest("zzz", []) == "nothing is known here"


def test_a_scene_with_many_mistakes_names_every_one():
    data = read_yaml(configs_folder() / "scenes" / "box-108.yaml")
    data["kapa"] = data.pop("kappa")
    data["limits"]["strain"] = -1
    data["mesh"]["cells"] = [1, 2, 2.5]
    data["physics"]["integrator"] = "rk5"
    data["pinned"] = {"axis": "z"}
    data["splits"]["tran"] = data["splits"].pop("train")
    data["splits"]["test"]["seeds"] = [10, 20]
    data["target"] = {"kind": "topcube"}
    assert mistakes_of(data, SceneConfig) == [
        "kapa: unknown key; did you mean 'kappa'?",
        "limits.strain: input should be greater than 0 (got -1)",
        "mesh.cells.2: input should be a valid integer (got 2.5)",
        "physics.integrator: there is no integrator 'rk5'; did you mean 'rk4'?",
        "pinned: the key 'kind' is missing",
        "splits.test: seeds 10 to 20 (excluded) are fewer than count = 128",
        "splits.tran: there is no split 'tran'; did you mean 'train'?",
        "target: 'topcube' is not one of 'top_cube', 'ellipsoid', 'under_surface', 'region'; did you mean 'top_cube'?",
    ]
