"""Make api.md: the public names with their signatures and docstrings, read from the sources.

Run by hand: `python docs/make_api.py`. Nothing is imported, so the page is the same wherever it is made; a test checks that it is
up to date.
"""

import ast
import pathlib
from collections.abc import Iterator
from typing import NamedTuple

ROOT = pathlib.Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "api.md"

ENVS = (
    "envs.resect.ResectEnv", "envs.resect.EpisodeState", "envs.pixels.PixelObservation", "envs.frames.Frames",
    "envs.vector.ResectVectorEnv", "envs.wrappers.FlatObservation", "envs.scene.Scene",
    "envs.scene.Certificate", "envs.scene.build_scene", "envs.library.load_scenes", "envs.library.load_scene_config",
    "envs.library.shipped_scenes", "envs.certify.certify", "envs.task.Resection", "envs.rewards.RewardTerm",
    "envs.rewards.Transition", "envs.scene_config.SceneConfig",
)  # fmt: skip
AGENTS = (
    "agents.choice.make_policy", "agents.evaluation.Policy", "agents.evaluation.evaluate", "agents.evaluation.summarise",
    "agents.evaluation.Episode", "agents.evaluation.Summary", "agents.scripted.ScriptedPolicy", "agents.scripted.Situation",
    "agents.shield.ShieldedPolicy", "agents.search.SearchPolicy", "agents.vector_face.ResectVecEnv",
    "agents.training_config.TrainingConfig", "agents.training.Trainer", "agents.checkpoint.load_policy",
    "agents.video.record_video", "agents.video.Player", "agents.recording.Recording", "agents.recording.read_recording",
    "agents.recording.write_recording", "agents.run_report.write_run_report", "agents.report.write_report",
)  # fmt: skip
"""What other programs may build on."""
DRAWING = ("gmapspring.render.render_body", "gmapspring.render.render_surface", "gmapspring.render.see_faces",
           "gmapspring.render.pick_faces", "gmapspring.render.Sight", "gmapspring.render.Style",
           "gmapspring.rendering.camera.Camera")

HEAD = """# Public names

This page is made by `python docs/make_api.py` from the docstrings; do not edit it. Lengths are in metres, masses in kilograms,
times in seconds. What is not listed here may change without notice.
"""


class Name(NamedTuple):
    """A public name and the statement that defines it."""

    shown: str
    """As users write it."""
    node: ast.ClassDef | ast.FunctionDef


def page() -> str:
    """Return the text of the page."""
    parts = [HEAD, "## gmapspring", *(_entry(name) for name in _exported("gmapspring"))]
    parts += ["## gmapspring, drawing", *(_entry(_find(path)) for path in DRAWING)]
    parts += ["## envs", "`gym.make` takes the arguments of the constructors.", *(_entry(_find(path)) for path in ENVS)]
    parts += ["## agents", *(_entry(_find(path)) for path in AGENTS)]
    return "\n\n".join(part.strip() for part in parts) + "\n"


def _exported(package: str) -> Iterator[Name]:
    """Yield what a package's `__all__` names; of modules, their public functions."""
    tree = _parse(ROOT / package / "__init__.py")
    origins = {alias.name: node.module for node in tree.body if isinstance(node, ast.ImportFrom) for alias in node.names}
    listed = next(node.value for node in tree.body if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "__all__")
    for name in sorted(ast.literal_eval(listed), key=str.lower):
        origin = origins[name]
        if (ROOT / package / f"{name}.py").is_file() and origin == package:
            yield from _functions(package, name)
        else:
            found = _find(f"{origin}.{name}")
            yield found._replace(shown=f"{package}.{name}")


def _functions(package: str, module: str) -> Iterator[Name]:
    """Yield the public functions of a module that are no kernels."""
    for node in _parse(ROOT / package / f"{module}.py").body:
        if isinstance(node, ast.FunctionDef) and not node.name.startswith("_") and not node.decorator_list:
            yield Name(f"{package}.{module}.{node.name}", node)


def _find(path: str) -> Name:
    """Return a name by its full path; a package takes its names from its modules."""
    module, _, name = path.rpartition(".")
    place = ROOT.joinpath(*module.split("."))
    file = place / "__init__.py" if place.is_dir() else place.with_suffix(".py")
    for node in _parse(file).body:
        if isinstance(node, ast.ClassDef | ast.FunctionDef) and node.name == name:
            return Name(path, node)
        if isinstance(node, ast.ImportFrom) and node.module and name in [alias.name for alias in node.names]:
            return _find(f"{node.module}.{name}")
    raise LookupError(f"there is no {path}; correct docs/make_api.py")


def _entry(name: Name) -> str:
    """Return the heading, signature and docstring of a name, with the fields and public methods of a class."""
    node = name.node
    text = ast.get_docstring(node) or ""
    if isinstance(node, ast.FunctionDef):
        return f"### {name.shown}\n\n```text\n{name.shown.rpartition('.')[2]}{_signature(node)}\n```\n\n{_prose(text)}"
    init = next((each for each in node.body if isinstance(each, ast.FunctionDef) and each.name == "__init__"), None)
    call = f"\n\n```text\n{node.name}{_signature(init)}\n```" if init else ""
    if init and ast.get_docstring(init):
        text += "\n\n" + (ast.get_docstring(init) or "")
    lines = [*_fields(node), *_methods(node)]
    return f"### {name.shown}{call}\n\n{_prose(text)}\n\n" + "\n".join(lines)


def _signature(node: ast.FunctionDef) -> str:
    """Return arguments and result as they are written, without self, broken where they are long."""
    arguments = ast.parse(ast.unparse(node)).body[0].args
    places = arguments.posonlyargs + arguments.args
    if places and places[0].arg in ("self", "cls"):
        (arguments.posonlyargs or arguments.args).pop(0)
    result = f" -> {ast.unparse(node.returns)}" if node.returns and node.name != "__init__" else ""
    return f"({ast.unparse(arguments)}){result}"


def _fields(node: ast.ClassDef) -> Iterator[str]:
    """Yield the annotated fields of a class with the docstrings under them."""
    for field, after in zip(node.body, [*node.body[1:], None], strict=True):
        if isinstance(field, ast.AnnAssign) and not ast.unparse(field.target).startswith("_"):
            yield f"- `{ast.unparse(field)}` {_docstring_of(after)}".rstrip()


def _docstring_of(node: ast.stmt | None) -> str:
    """Return the text of a statement that is but a string."""
    is_text = isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)
    return _in_line(node.value.value) if is_text else ""


def _methods(node: ast.ClassDef) -> Iterator[str]:
    """Yield the public methods and properties of a class with the first sentences of their docstrings."""
    for each in node.body:
        if isinstance(each, ast.FunctionDef) and not each.name.startswith("_") and not _is_behind(each):
            is_property = any("property" in ast.unparse(mark) for mark in each.decorator_list)
            first = (ast.get_docstring(each) or "").partition("\n\n")[0]
            yield f"- `.{each.name}{'' if is_property else _signature(each)}` {_in_line(first)}".rstrip()


def _is_behind(node: ast.FunctionDef) -> bool:
    """Tell whether a method checks a configuration, or sets a property: nobody calls it."""
    return any(word in ast.unparse(mark) for mark in node.decorator_list for word in ("validator", ".setter"))


def _prose(text: str) -> str:
    """Return a docstring as Markdown: a list of arguments keeps its lines, and nothing is taken for HTML."""
    text = text.replace("<", "&lt;")
    return "\n".join(f"- {line.strip()}" if line.startswith("    ") else line for line in text.splitlines())


def _in_line(text: str) -> str:
    """Return a text in one line."""
    return " ".join(text.split()).replace("<", "&lt;")


def _parse(path: pathlib.Path) -> ast.Module:
    """Return the syntax tree of a file."""
    return ast.parse(path.read_text(encoding="utf-8"))


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
    print(f"wrote {PAGE}")
