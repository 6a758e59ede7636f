"""The pages of docs/ tell the truth: their code runs and prints what they say, and their links lead somewhere."""

import importlib.util
import pathlib
import shutil

import pytest

from tests.documentation import REPOSITORY, apply_diff, blocks_of, check_blocks, missing_links, read_page, sections_of

WRITTEN = ("tutorial.md", "extending.md", "map.md", "api.md")
"""Pages that are written by hand, or made from docstrings."""
EXTENDING = sections_of(read_page("docs/extending.md"))
CHANGE_KERNELS = ("A cut operation", "An integrator", "A force")
"""Sections that need a copy of the packages: kernels of the repository that are compiled already would not see the change."""
SLOW = {"A scene": pytest.mark.slow}
"""What certifies a scene."""
OTHERS = [pytest.param(name, marks=SLOW.get(name, ())) for name, text in EXTENDING.items()
          if blocks_of(text) and name not in CHANGE_KERNELS]  # fmt: skip


@pytest.mark.parametrize("page", [pytest.param("tutorial.md", marks=pytest.mark.slow), "map.md"])
def test_the_code_of_the_page_runs_and_prints_what_it_says(page, tmp_path):
    blocks = blocks_of(read_page(f"docs/{page}"))
    assert len([block for block in blocks if block.output]) >= 3
    check_blocks(blocks, tmp_path)


@pytest.mark.parametrize("section", OTHERS)
def test_packages_extended_as_the_page_says_do_what_it_says(section, tmp_path):
    check_blocks(blocks_of(EXTENDING[section]), tmp_path)


def check_kernels(folder, **settings):
    """Extend a copy of the packages by all sections that change kernels, and run it."""
    for package in ("gmapspring", "configs"):
        shutil.copytree(REPOSITORY / package, folder / package, ignore=shutil.ignore_patterns("__pycache__"))
    check_blocks([block for section in CHANGE_KERNELS for block in blocks_of(EXTENDING[section])], folder, **settings)


def test_kernels_extended_as_the_page_says_do_what_it_says(tmp_path):
    check_kernels(tmp_path, NUMBA_DISABLE_JIT="1")  # compiled, they would take half a minute


@pytest.mark.slow
def test_kernels_extended_as_the_page_says_compile(tmp_path):
    check_kernels(tmp_path, NUMBA_CACHE_DIR=str(tmp_path / "compiled"))


@pytest.mark.parametrize("page", WRITTEN)
def test_the_links_lead_somewhere(page):
    assert missing_links(read_page(f"docs/{page}"), REPOSITORY / "docs") == []


def test_the_api_page_is_up_to_date():
    place = importlib.util.spec_from_file_location("make_api", REPOSITORY / "docs" / "make_api.py")
    maker = importlib.util.module_from_spec(place)
    place.loader.exec_module(maker)
    assert read_page("docs/api.md") == maker.page(), "run python docs/make_api.py"


def test_output_that_differs_from_the_page_is_noticed(tmp_path):
    page = "```python\nprint(1 + 1)\n```\n\n```text\n3\n```\n"
    with pytest.raises(AssertionError, match="prints\n2"):
        check_blocks(blocks_of(page), tmp_path)


def test_a_diff_whose_context_is_not_there_is_noticed(tmp_path):
    pathlib.Path(tmp_path / "a.txt").write_text("one\ntwo\n")
    diff = "--- a.txt\n+++ a.txt\n@@\n {}\n+three\n"
    apply_diff(diff.format("two"), tmp_path)
    assert (tmp_path / "a.txt").read_text() == "one\ntwo\nthree\n"
    with pytest.raises(AssertionError, match="0 times"):
        apply_diff(diff.format("four"), tmp_path)
