"""Imports run one way: gmapspring <- envs <- agents <- tests, and inside gmapspring darts and forces never meet."""

import ast
import itertools
import pathlib

import pytest

ROOT = pathlib.Path(__file__).parents[2]
LAYERS = ("gmapspring", "envs", "agents", "tests")
"""Each may import those before it, none after it."""
ONLY_IN = {
    "torch": ("agents", "tests"),
    "stable_baselines3": ("agents", "tests"),
    "sb3_contrib": ("agents", "tests"),
    "gymnasium": ("envs", "agents", "tests"),
}
"""Where a third-party package may be imported; what is not named here may be imported anywhere."""
MAP_CHANGES = {"gmapspring.topology." + name for name in ("cells", "components", "sewing")}
"""What changes the map: imported by the map itself and by the cutting."""
MAP = {"gmapspring.topology"}
"""The map: imports no physics."""
FORCES = {"gmapspring." + name for name in ("forces", "contact", "spring_kernel", "integrators")}
"""What moves nodes: imports no darts, and nothing that does."""
CUTTING = {"gmapspring." + name for name in ("cut", "embedding")}
"""What changes map and mechanics together."""
SHELLS = {"gmapspring." + name for name in ("body", "simulation")}
"""What holds the two beside each other."""
BOTTOM = {"gmapspring." + name for name in ("addresses", "errors", "jit", "numba_flags", "prefetch")}
"""What the map may import besides itself."""


def load_sources(root):
    """Return the source of every module of the layers, by dotted name."""
    paths = (path for layer in LAYERS for path in sorted((root / layer).rglob("*.py")))
    return {module_name(path.relative_to(root)): path.read_text(encoding="utf-8") for path in paths}


def module_name(path):
    """Return the dotted name of the module in a file."""
    parts = path.with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def is_part_of(module, package):
    """Tell whether a module is a package or lies in it."""
    return module == package or module.startswith(package + ".")


def imported(name, source, modules, is_package):
    """Return what one source imports as dotted names, wherever the statement stands; `from a import b` is a.b if b is
    a module, else a."""
    found = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            found.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = resolved(name, node, is_package)
            for alias in node.names:
                inner = f"{base}.{alias.name}"
                found.add(inner if inner in modules else base)
        elif is_dynamic_import(node):
            found.add(node.args[0].value)
    return found - {name}


def resolved(name, node, is_package):
    """Return the absolute name of the module that a from-import names."""
    if not node.level:
        return node.module
    parts = name.split(".")
    parts = parts[: len(parts) - node.level + is_package]
    return ".".join([*parts, *([node.module] if node.module else [])])


def is_dynamic_import(node):
    """Tell whether a node is importlib.import_module("...") or __import__("...") with a constant name."""
    if not (isinstance(node, ast.Call) and node.args and isinstance(node.args[0], ast.Constant)):
        return False
    called = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
    return called in ("import_module", "__import__") and isinstance(node.args[0].value, str)


def import_graph(sources):
    """Return, for every module, the set of what it imports."""
    packages = {name.rpartition(".")[0] for name in sources}
    return {name: imported(name, text, sources, name in packages) for name, text in sources.items()}


def layer_faults(graph):
    """List imports that run against the order of the layers."""
    layer_of = {name: LAYERS.index(name.partition(".")[0]) for name in graph}
    return [f"{name} imports {target}" for name, targets in graph.items() for target in sorted(targets)
            for layer in LAYERS[layer_of[name] + 1:] if is_part_of(target, layer)]  # fmt: skip


def third_party_faults(graph):
    """List imports of a package where it is not allowed."""
    return [f"{name} imports {target}" for name, targets in graph.items() for target in sorted(targets)
            for package, allowed in ONLY_IN.items()
            if is_part_of(target, package) and name.partition(".")[0] not in allowed]  # fmt: skip


def in_any(module, packages):
    """Tell whether a module is one of some packages or lies in one."""
    return any(is_part_of(module, package) for package in packages)


def darts_and_forces_faults(graph):
    """List imports inside gmapspring that mix darts and physics anywhere but in cutting and shells."""
    faults = []
    for name, targets in graph.items():
        inside = sorted(target for target in targets if target.startswith("gmapspring."))
        if in_any(name, MAP):
            faults += [f"{name} imports {t}" for t in inside if not in_any(t, MAP | BOTTOM)]
        elif in_any(name, FORCES):
            faults += [f"{name} imports {t}" for t in inside if in_any(t, MAP | CUTTING | SHELLS)]
        elif name not in CUTTING | SHELLS:
            pairs = itertools.product(*([t for t in inside if in_any(t, side)] for side in (MAP, FORCES)))
            faults += [f"{name} imports both {dart} and {force}" for dart, force in pairs]
        if not in_any(name, MAP | CUTTING | {"tests"}):
            faults += [f"{name} imports {t}" for t in inside if in_any(t, MAP_CHANGES)]
    return faults


def cycle_faults(graph):
    """List the modules from which an import leads back to themselves; importing a package means its __init__ alone."""
    edges = {name: {target for target in targets if target in graph} for name, targets in graph.items()}
    faults = []
    for start in edges:
        reached, waiting = set(), [start]
        while waiting:
            news = edges[waiting.pop()] - reached
            reached |= news
            waiting += news
        faults += [f"{start} imports itself"] if start in reached else []
    return faults


RULES = (layer_faults, third_party_faults, darts_and_forces_faults, cycle_faults)

LAYER, THIRD_PARTY, INNER, CYCLE = RULES
NAMED = MAP | MAP_CHANGES | {"gmapspring.topology.gmap", "gmapspring.topology.darts"} | FORCES | CUTTING | SHELLS | BOTTOM
FAKES = dict.fromkeys(sorted(NAMED), "")
"""Empty modules, so that `from gmapspring.topology import gmap` is known to name one."""

BAD_SOURCES = [
    (LAYER, {"gmapspring.body": "from envs.scene import Scene"}),
    (LAYER, {"gmapspring.body": "def late():\n    import agents.ppo as ppo"}),
    (LAYER, {"envs.resect": "import importlib\nimportlib.import_module('agents.ppo')"}),
    (LAYER, {"envs.resect": "from tests import naive"}),
    (LAYER, {"agents.ppo": "from tests.naive import NaiveBody"}),
    (THIRD_PARTY, {"envs.resect": "import torch.nn as nn"}),
    (THIRD_PARTY, {"envs.resect": "from stable_baselines3.common.env_checker import check_env"}),
    (THIRD_PARTY, {"gmapspring.simulation": "if True:\n    from sb3_contrib import MaskablePPO"}),
    (THIRD_PARTY, {"gmapspring.render": "from gymnasium import spaces"}),
    (INNER, {"gmapspring.forces": "from gmapspring.topology.gmap import alpha"}),
    (INNER, {"gmapspring.forces": "from gmapspring import cut"}),
    (INNER, {"gmapspring.forces": "from gmapspring.body import Nodes"}),
    (INNER, {"gmapspring.integrators.rk4": "from ..topology import darts"}),
    (INNER, {"gmapspring.contact": "import gmapspring.topology.walks"}),
    (INNER, {"gmapspring.topology.gmap": "from ..body import Nodes"}),
    (INNER, {"gmapspring.topology.cells": "from gmapspring.forces import add_spring_forces"}),
    (INNER, {"gmapspring.topology.walks": "from gmapspring.mesh import Mesh"}),
    (INNER, {"gmapspring.render": "from gmapspring import forces\nfrom gmapspring.topology import gmap"}),
    (INNER, {"gmapspring.measure": "from gmapspring.topology.sewing import sew"}),
    (INNER, {"envs.task": "from gmapspring.topology import cells"}),
    (CYCLE, {"gmapspring.a": "from gmapspring import b", "gmapspring.b": "import gmapspring.a"}),
    (CYCLE, {"gmapspring.a": "from . import b", "gmapspring.b": "def late():\n    from .c import d",
             "gmapspring.c": "from .a import e"}),
    (CYCLE, {"gmapspring": "from .a import b", "gmapspring.a": "from gmapspring import c"}),
]  # fmt: skip


@pytest.mark.parametrize("rule", RULES, ids=lambda rule: rule.__name__)
def test_no_module_breaks_the_rule(rule):
    assert rule(import_graph(load_sources(ROOT))) == []


@pytest.mark.parametrize(("rule", "sources"), BAD_SOURCES, ids=lambda part: getattr(part, "__name__", ""))
def test_the_rule_notices_a_bad_source(rule, sources):
    assert rule(import_graph(FAKES)) == []
    assert len(rule(import_graph(FAKES | sources))) >= 1


def test_the_rules_let_good_sources_pass():
    sources = {
        "gmapspring": "from gmapspring.simulation import Simulation",
        "gmapspring.topology.gmap": "from gmapspring.jit import kernel\nfrom gmapspring.topology import darts",
        "gmapspring.topology.darts": "import numpy as np",
        "gmapspring.jit": "import numba",
        "gmapspring.forces": "from .jit import kernel",
        "gmapspring.cut": "from gmapspring import forces\nfrom gmapspring.topology import gmap",
        "gmapspring.simulation": "from . import cut",
        "envs.resect": "import gymnasium\nimport gmapspring",
        "agents.ppo": "import torch\nimport envs",
        "tests.naive": "import agents.ppo\nimport torch",
    }
    assert [fault for rule in RULES for fault in rule(import_graph(sources))] == []


def test_the_package_is_found_where_the_test_looks():
    assert {"gmapspring.jit", "gmapspring.errors"} <= set(load_sources(ROOT))


def test_the_modules_named_in_the_rules_exist():
    sources = load_sources(ROOT)
    future = {"gmapspring.contact"}
    assert {name for name in FAKES if name not in sources} <= future
