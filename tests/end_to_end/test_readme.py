"""The README tells the truth: its example prints what it says, and its commands exist."""

import ast
import pathlib
import re
import shlex
import subprocess
import sys

from agents.command_line import _parser

REPOSITORY = pathlib.Path(__file__).parents[2]
README = (REPOSITORY / "README.md").read_text(encoding="utf-8")


def blocks(language):
    """Return the fenced blocks of one language."""
    return re.findall(rf"```{language}\n(.*?)```", README, flags=re.DOTALL)


def test_the_examples_print_what_the_readme_says(tmp_path):
    outputs = blocks("text")
    examples = blocks("python")
    assert len(examples) == len(outputs) >= 1
    for example, output in zip(examples, outputs, strict=True):
        run = subprocess.run([sys.executable, "-c", example], cwd=tmp_path, capture_output=True, text=True, timeout=300)
        assert run.returncode == 0, run.stderr
        assert run.stdout == output


def test_the_commands_exist_and_the_links_lead_somewhere():
    makefile = (REPOSITORY / "Makefile").read_text(encoding="utf-8")
    for target in re.findall(r"make ([a-z-]+)", README):
        assert re.search(rf"^{target}:", makefile, flags=re.MULTILINE), target
    for command in re.findall(r"^    gmapspring ([^\n]*)$", README, flags=re.MULTILINE):
        _parser().parse_args(shlex.split(command))
    for link in re.findall(r"\]\(([^)#:]+)\)", README):
        assert (REPOSITORY / link).exists(), link


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
