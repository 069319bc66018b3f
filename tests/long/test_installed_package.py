"""The built wheel, installed by itself: all that the package needs at run time is inside."""

import os
import subprocess
import sys
import sysconfig
import venv
import zipfile
from pathlib import Path

import pytest
from scripts import ROOT

SMOKE = """
import sys

import maesn
from maesn.studies.reading import shipped_studies
from maesn.runs.sources import policy_names

assert maesn.__file__.startswith(sys.prefix), maesn.__file__
assert {"ant", "blockpush", "sparse_point", "wheeled"} <= set(policy_names())
assert {"ablation", "paper", "quick"} <= set(shipped_studies())
for name in shipped_studies():
    assert maesn.Study.load(name).jobs
for name in policy_names():
    run = maesn.Run.open(name)
    run.world(run.task_set("test")).close()
"""


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("wheel")
    command = [sys.executable, "-m", "pip", "wheel", str(ROOT), "--no-deps", "--quiet"]
    subprocess.run([*command, "--wheel-dir", str(folder)], check=True)
    (built,) = folder.glob("maesn-*.whl")
    return built


@pytest.fixture(scope="module")
def python(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An environment with the wheel, and with what it depends on from the present one."""
    folder = tmp_path_factory.mktemp("environment")
    venv.create(folder, with_pip=False)
    own = Path(sysconfig.get_path("purelib", vars={"base": str(folder), "platbase": str(folder)}))
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(own)
    # Behind the wheel's own packages, so that the editable one of this tree is not found first.
    (own / "dependencies.pth").write_text(sysconfig.get_path("purelib"))
    return folder / "bin" / "python"


def call(python: Path, folder: Path, *arguments: str) -> str:
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    return subprocess.run(
        [str(python), *arguments],
        cwd=folder,
        env=environment,
        check=True,
        capture_output=True,
        text=True,
    ).stdout


def test_the_wheel_holds_policies_models_and_studies(wheel: Path) -> None:
    inside = set(zipfile.ZipFile(wheel).namelist())
    package = ROOT / "src" / "maesn"
    wanted = {
        f"maesn/{path.relative_to(package)}"
        for path in package.rglob("*")
        if path.is_file() and path.suffix != ".pyc" and "__pycache__" not in path.parts
    }
    assert wanted <= inside
    assert any(name.endswith("models/ant.xml") for name in inside)
    assert not [name for name in inside if name.startswith(("tests/", "docs/", "results/"))]


def test_the_installed_package_works_outside_of_the_tree(python: Path, tmp_path: Path) -> None:
    call(python, tmp_path, "-c", SMOKE)


def test_its_commands_work(python: Path, tmp_path: Path) -> None:
    assert "all is well" in call(python, tmp_path, "-m", "maesn", "doctor")
    few = ("--num-tasks", "2", "--episodes", "3", "--rule", "search")
    shown = call(python, tmp_path, "-m", "maesn", "adapt", "wheeled", *few)
    assert "maesn-wheeled/adaptation/" in shown
    call(python, tmp_path, "-m", "maesn", "export", "wheeled", "policy.npz")
    assert (tmp_path / "policy.npz").is_file()
