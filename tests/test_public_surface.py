"""The public surface: one path per name, loaded when used; and no method without documentation."""

import ast
import re
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest

import maesn
from maesn import learners

ROOT = Path(maesn.__file__).parent
HEAVY = {"equinox", "jax", "matplotlib", "mujoco", "numpy", "rich", "scipy", "tyro"}
NAMES = sorted(maesn._MODULE_OF)
MODULES = {
    ".".join(("maesn", *path.relative_to(ROOT).with_suffix("").parts)).removesuffix(".__init__"): (
        path
    )
    for path in sorted(ROOT.rglob("*.py"))
    # Importing these is running the program, or needs a simulator.
    if path.stem != "__main__" and path.parent.name != "adapters"
}


def loaded_by(statement: str) -> set[str]:
    """The top-level packages that a fresh interpreter has loaded after `statement`."""
    program = f"{statement}\nimport sys\nprint(*{{name.partition('.')[0] for name in sys.modules}})"
    command = [sys.executable, "-c", program]
    return set(subprocess.run(command, capture_output=True, text=True, check=True).stdout.split())


def methods(path: Path) -> list[tuple[str, str]]:
    """The (class, method) pairs of a file, public ones only, that have no docstring themselves."""
    return [
        (definition.name, method.name)
        for definition in ast.parse(path.read_text(encoding="utf-8")).body
        if isinstance(definition, ast.ClassDef) and not definition.name.startswith("_")
        for method in definition.body
        if isinstance(method, ast.FunctionDef) and not method.name.startswith("_")
        if ast.get_docstring(method) is None
    ]


def documented_by_interface(owner: type, method: str) -> bool:
    return any((getattr(base, method, None).__doc__ or "").strip() for base in owner.__mro__[1:-1])


def test_importing_the_package_loads_nothing_heavy() -> None:
    assert not loaded_by("import maesn; maesn.__version__; dir(maesn)") & HEAVY


def test_every_heavy_package_would_be_noticed() -> None:
    # Guards the test above against a name that no longer means anything.
    assert loaded_by("import " + ", ".join(sorted(HEAVY))) >= HEAVY


@pytest.mark.parametrize("name", NAMES)
def test_public_name_resolves_and_is_documented(name: str) -> None:
    value = getattr(maesn, name)
    assert value is getattr(import_module(maesn._MODULE_OF[name]), name)
    assert name in dir(maesn)
    assert (value.__doc__ or "").strip()


def test_each_public_name_stands_once_in_the_stub_and_is_exported_to_type_checkers() -> None:
    stub = ast.parse((ROOT / "__init__.pyi").read_text(encoding="utf-8"))
    imports = [one for one in stub.body if isinstance(one, ast.ImportFrom)]
    aliases = [alias for one in imports for alias in one.names]
    assert sorted(alias.name for alias in aliases) == NAMES
    # Only `X as X` tells a type checker that the name is public.
    assert all(alias.asname == alias.name for alias in aliases)


def test_no_public_name_is_hidden_by_a_module() -> None:
    # `import maesn.x` sets the attribute `x` of the package to the module.
    assert not {f"maesn.{name}" for name in NAMES} & MODULES.keys()


def test_an_unknown_name_is_refused_by_name() -> None:
    with pytest.raises(AttributeError, match="`no_such_name`"):
        maesn.__getattr__("no_such_name")


@pytest.mark.parametrize("module", MODULES)
def test_every_method_is_documented_by_itself_or_its_interface(module: str) -> None:
    loaded = import_module(module)
    bare = [
        f"{owner}.{method}"
        for owner, method in methods(MODULES[module])
        if not documented_by_interface(getattr(loaded, owner), method)
    ]
    assert not bare


def test_nothing_outside_of_the_learners_knows_a_concrete_one() -> None:
    """Others ask what a learner can do; presets make learners, and `maesn` names them for users."""
    kinds: list[type] = [learners.AbstractFastLearner, learners.AbstractMetaLearner]
    for kind in kinds:  # which grows by their subclasses
        kinds += kind.__subclasses__()
    concrete = {
        one.__name__
        for one in kinds
        if one.__module__.startswith("maesn.learners.") and not one.__name__.startswith("Abstract")
    }
    assert {"GradientMetaLearner", "GradientFastLearner", "BonusFastLearner"} <= concrete
    for path in ROOT.rglob("*.py"):
        if not path.is_relative_to(ROOT / "learners"):
            nodes = ast.walk(ast.parse(path.read_text("utf-8")))
            used = {
                node.id if isinstance(node, ast.Name) else node.attr
                for node in nodes
                if isinstance(node, ast.Name | ast.Attribute)
            }
            assert not used & concrete, path


def test_no_import_of_the_library_hides_from_the_contracts() -> None:
    """A name that is put together at run time, or taken from a string, is no import to a linter."""
    hidden = {
        path.relative_to(ROOT).as_posix()
        for path in ROOT.rglob("*.py")
        if re.search(r"(import_module|__import__)\(\s*f?[\"']maesn", path.read_text("utf-8"))
    }
    assert hidden == {"cli.py"}  # whose commands' imports wait for their turn
