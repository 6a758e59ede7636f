"""Every script in examples/ runs by itself in an empty folder and prints what its first lines say."""

import ast
import os
import re
import subprocess
import sys
import textwrap

import pytest

from tests.documentation import REPOSITORY

EXAMPLES = sorted((REPOSITORY / "examples").glob("*.py"))
SLOW = {"own_scene": pytest.mark.slow}
"""What certifies a scene."""


def said_output(path):
    """Return what the docstring of a script says that it prints."""
    docstring = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8")))
    return textwrap.dedent(docstring.partition("Prints:\n")[2]).strip() + "\n"


@pytest.mark.parametrize("path", [pytest.param(path, marks=SLOW.get(path.stem, ()), id=path.stem) for path in EXAMPLES])
def test_the_example_prints_what_it_says(path, tmp_path):
    environment = os.environ | {"PYTHONPATH": str(REPOSITORY)}
    run = subprocess.run([sys.executable, str(path)], cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=300)
    assert run.returncode == 0, run.stderr
    assert run.stdout == said_output(path)


def test_there_are_examples_of_every_layer():
    text = {path.stem: path.read_text(encoding="utf-8") for path in EXAMPLES}
    for layer in ("gmapspring", "envs", "agents"):
        assert any(re.search(rf"^(?:import|from) {layer}\b", code, flags=re.MULTILINE) for code in text.values()), layer
    assert all(said_output(path).strip() for path in EXAMPLES)
