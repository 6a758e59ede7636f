"""The README tells the truth: its example prints what it says, and its commands exist."""

import ast
import re
import shlex

from agents.command_line import _parser
from tests.documentation import REPOSITORY, blocks_of, check_blocks, missing_links, read_page

README = read_page("README.md")


def test_the_examples_print_what_the_readme_says(tmp_path):
    examples = blocks_of(README)
    assert len(examples) >= 1
    assert all(example.language == "python" and example.output for example in examples)
    for example in examples:
        # Each by itself: a reader may start with any of them.
        check_blocks([example], tmp_path)


def test_the_commands_exist_and_the_links_lead_somewhere():
    makefile = (REPOSITORY / "Makefile").read_text(encoding="utf-8")
    for target in re.findall(r"make ([a-z-]+)", README):
        assert re.search(rf"^{target}:", makefile, flags=re.MULTILINE), target
    for command in re.findall(r"^    gmapspring ([^\n]*)$", README, flags=re.MULTILINE):
        _parser().parse_args(shlex.split(command))
    assert missing_links(README, REPOSITORY) == []


def test_the_code_map_says_of_every_module_what_its_first_line_says():
    sections = re.split(r"^\*\*`([\w/]+)/`\*\*", README, flags=re.MULTILINE)
    maps = dict(zip(sections[1::2], sections[2::2], strict=True))
    assert {"gmapspring", "gmapspring/integrators", "envs", "agents"} <= maps.keys()
    # The tests are told of by folder.
    for folder, table in ((folder, table) for folder, table in maps.items() if not folder.startswith("tests")):
        found = dict(re.findall(r"^\| `(\w+\.py)` \| (.*) \|$", table, flags=re.MULTILINE))
        modules = [path for path in (REPOSITORY / folder).glob("*.py") if not path.name.startswith("__")]
        expected = {path.name: ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) for path in modules}
        assert found == {name: text.splitlines()[0].rstrip(".") for name, text in expected.items()}, folder
