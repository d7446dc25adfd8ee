"""The laws of the house, read from the source: who may import whom, and what nobody may do."""

import ast
import importlib
import inspect
import re
import sys
from functools import cache
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[1] / "sparsefit"
GUIDE = (PACKAGE.parent / "CONTRIBUTING.md").read_text(encoding="utf-8")
ORDER = GUIDE.partition("precede it in this order:")[2].partition("`tests/")[0]
ROOMS = tuple(re.findall(r"`(\w+)`", ORDER))
SOLVERS = {"cvxpy", "clarabel", "osqp", "scs", "highspy", "ecos"}
PEERS = {"sklearn", "celer", "skglm", "pysindy", "glum", "sortedl1", "spams"}
BRIDGES = {"sklearn", "pysindy"}  # rooms that are for users of a peer
PICKLES = {"pickle", "dill", "cloudpickle", "joblib", "marshal", "shelve"}  # of our processes only
READERS = {"pyulog", "aerofiles", "pyproj"}  # of logs
NAMED = re.compile(r"sparsefit(\.[a-z_]+)+(:\w+)?")  # what importlib is given
FILES = sorted(PACKAGE.rglob("*.py"))


def name_of(path):
    return ".".join(("sparsefit", *path.relative_to(PACKAGE).with_suffix("").parts))


@cache
def tree_of(path):
    return ast.parse(path.read_text())


@cache
def nodes_of(path):
    return tuple(ast.walk(tree_of(path)))


@cache
def calls():
    """(path, node, name) of every call in the package."""
    return tuple(
        (path, node, ast.unparse(node.func))
        for path in FILES
        for node in nodes_of(path)
        if isinstance(node, ast.Call)
    )


@cache
def imports_of(path):
    """(module, line) of every import, wherever it stands: for type checkers and by name too."""
    return tuple(_imports_of(path))


def _imports_of(path):
    package = name_of(path).removesuffix(".__init__").split(".")
    package = package if path.stem == "__init__" else package[:-1]
    for node in nodes_of(path):
        if isinstance(node, ast.Import):
            yield from ((alias.name, node.lineno) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            stem = package[: len(package) - node.level + 1] if node.level else []
            module = ".".join([*stem, *([node.module] if node.module else [])])
            yield module, node.lineno
            yield from ((f"{module}.{alias.name}", node.lineno) for alias in node.names)
        elif isinstance(node, ast.Constant) and NAMED.fullmatch(str(node.value)):
            yield node.value.partition(":")[0], node.lineno


def imports():
    """(path, its room, module, line) of every import of the package."""
    for path in FILES:
        yield from ((path, room_of(name_of(path)), *imported) for imported in imports_of(path))


def room_of(module):
    parts = module.split(".")
    return parts[1] if len(parts) > 1 and parts[0] == "sparsefit" else None


def test_every_room_has_its_place_in_the_order():
    found = {room_of(name_of(path)) for path in FILES} - {"__init__", "__main__"}
    assert len(ROOMS) == len(set(ROOMS))
    assert found == set(ROOMS)


def test_a_room_imports_only_rooms_above_it():
    wrong = [
        f"{name_of(path)}:{line} imports {module}"
        for path, room, module, line in imports()
        if room in ROOMS and room_of(module) in ROOMS[ROOMS.index(room) + 1 :]
    ]
    assert not wrong


def test_no_room_imports_a_name_from_the_list_of_public_names():
    wrong = [
        f"{name_of(path)}:{line} imports {module}"
        for path, room, module, line in imports()
        if room in ROOMS and room != "cli" and room_of(module) not in {*ROOMS, None}
    ]
    assert not wrong


def test_solvers_peers_and_pickles_are_imported_by_those_who_are_for_them():
    homes = {
        **{solver: {"backends", "solvers"} for solver in SOLVERS},
        **{peer: {peer} & BRIDGES for peer in PEERS},
        **{one: {"sparsefit.study.guardian", "sparsefit.study.worker"} for one in PICKLES},
    }
    wrong = [
        f"{name_of(path)}:{line} imports {module}"
        for path, room, module, line in imports()
        if not {room, name_of(path)} & homes.get(module.split(".")[0], {room})
    ]
    assert not wrong


def needs_of(path, modules):
    """The modules that a module imports; of `from room import file` the file, not the room."""
    names = {module for module, _ in imports_of(path)} & set(modules)
    return {name for name in names if not any(other.startswith(f"{name}.") for other in names)}


def test_no_module_imports_itself_by_way_of_others():
    modules = {name_of(path).removesuffix(".__init__"): path for path in FILES}
    modules.pop("sparsefit")  # the list of public names
    edges = {name: needs_of(path, modules) - {name} for name, path in modules.items()}
    while edges:
        free = {name for name, needs in edges.items() if not needs & set(edges)}
        assert free, f"a circle among {sorted(edges)}"
        edges = {name: needs for name, needs in edges.items() if name not in free}


@pytest.mark.parametrize("name", ["losses", "penalties", "certificate"])
def test_the_objective_is_numpy_only(name):
    rooms = {"errors", "arrays", "cached", "regression"}
    for module, line in imports_of(PACKAGE / "regression" / f"{name}.py"):
        top = module.split(".")[0]
        known = room_of(module) in rooms or top in {"numpy", "scipy"}
        assert known or top in sys.stdlib_module_names, f"line {line} imports {module}"


def test_nothing_runs_text_or_pickles_or_opens_a_shell():
    forbidden = {"eval", "exec", "os.system", "os.popen"}
    wrong = [
        f"{name_of(path)}:{node.lineno} calls {called}"
        for path, node, called in calls()
        if called in forbidden
        or called.endswith((".read_pickle", ".to_pickle"))
        or any(
            keyword.arg in {"shell", "allow_pickle"} and ast.unparse(keyword.value) == "True"
            for keyword in node.keywords
        )
    ]
    assert not wrong


def test_files_are_written_whole_or_not_at_all():
    wrong = [
        f"{name_of(path)}:{node.lineno}"
        for path, node, called in calls()
        if called.endswith((".write_text", ".write_bytes"))
    ]
    assert not wrong


def test_what_is_public_has_a_docstring_of_its_own_or_an_inherited_one():
    names = {name_of(path).removesuffix(".__init__") for path in FILES}
    names -= {"sparsefit.__main__", *(f"sparsefit.{room}" for room in BRIDGES)}  # slow to import
    modules = map(importlib.import_module, sorted(names))
    assert not [missing for module in modules for missing in undocumented(module)]


def undocumented(module):
    """Names of the methods and properties of a module's public classes that say nothing.

    Modules, functions and classes are ruff's; a method that overrides one may say nothing new.
    """
    for cls in vars(module).values():
        if inspect.isclass(cls) and cls.__module__ == module.__name__ and cls.__name__[0] != "_":
            for name, member in vars(cls).items():
                is_code = inspect.isfunction(member) or hasattr(member, "__get__")
                if name[0] != "_" and is_code and not inspect.getdoc(getattr(cls, name)):
                    yield f"{module.__name__}.{cls.__name__}.{name}"


def test_files_stay_readable():
    assert not [path for path in FILES if len(path.read_text().splitlines()) > 500]


def test_records_are_frozen():
    wrong = [
        f"{name_of(path)}:{node.lineno} {node.name}"
        for path in FILES
        if room_of(name_of(path)) not in {"study", "cli"}  # a pool of workers is no record
        for node in nodes_of(path)
        if isinstance(node, ast.ClassDef)
        for text in map(ast.unparse, node.decorator_list)
        if text.startswith("dataclass") and "frozen=True" not in text
    ]
    assert not wrong


def test_random_numbers_come_from_seeds():
    seeded = {"default_rng", "SeedSequence", "Generator"}
    wrong = [
        f"{name_of(path)}:{node.lineno} {called}"
        for path, node, called in calls()
        if called.endswith("default_rng") and not node.args and not node.keywords
    ]
    assert not wrong
    wrong = [
        f"{name_of(path)}:{node.lineno} {node.attr}"
        for path in FILES
        for node in nodes_of(path)
        if isinstance(node, ast.Attribute)
        and isinstance(node.value, ast.Attribute)
        and (node.value.attr, getattr(node.value.value, "id", "")) == ("random", "np")
        and node.attr not in seeded
    ]
    assert not wrong
