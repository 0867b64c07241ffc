"""Packaging: names, versions, pins, executables, and the build with colcon."""

from __future__ import annotations

import ast
import os
import re
import shlex
import shutil
import subprocess
import sys
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Any

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from servo_twin._build_native import OPTIONS, build_identity, generated_for

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("servo_msgs_py", "servo_bridge", "servo_twin")
EXECUTABLES = {
    "servo_bridge": ("servo_bridge", "servo-command", "servo-demo", "servo-tool"),
    "servo_twin": ("servo-sim", "servo-twin", "servo-up", "servo_twin", "servo_viewer", "virtual_board"),
}
EXECUTABLE_NAMES = [(package, name) for package, names in EXECUTABLES.items() for name in names]
PYTHONS = ("3.10", "3.11", "3.12", "3.13")
FOLDERS = {".ci", "firmware", "servo_bridge", "servo_msgs_py", "servo_twin", "tests"}

# Permitted imports of each package from the other packages.
NEIGHBOURS = {"servo_msgs_py": set(), "servo_bridge": {"servo_msgs_py"}, "servo_twin": {"servo_msgs_py"}}
# Modules whose name is not the rosdep key in package.xml, and modules that have no key.
MODULES_OF_KEY = {"python3-serial": {"serial"}, "python3-cffi": {"cffi"}}
WITHOUT_KEY = {
    "servo_msgs_py": {"lz4", "mcap", "rerun", "rosbags", "tomli", "zstandard"},
    "servo_bridge": {"argcomplete", "rerun", "tomli"},
    "servo_twin": {"gymnasium", "mujoco", "pyarrow", "rerun", "tomli"},
}

HOSTS = {
    "www.apache.org",
    "www.eprosima.com",
    "download.ros.org",
    "www.w3.org",
    "docs.ros.org",
    "localhost",
    "127.0.0.1",
}
UNWANTED = {
    "a path of one machine": re.compile(r"(?<![>}])/(?:[h]ome|[r]oot|[w]ork|[U]sers)/\w"),
    "a choice of package index": re.compile(r"--(?:extra-)?index[-]url|--find[-]links|--trusted[-]host"),
    "something left open": re.compile(r"\b(?:[T]ODO|[F]IXME|[X]XX|[H]ACK)\b"),
}


def clean_environment() -> dict[str, str]:
    """Environment without the variables of an outer make."""
    return {name: value for name, value in os.environ.items() if name not in ("MAKEFLAGS", "MAKELEVEL", "MFLAGS")}


def run(*command: str | Path, cwd: Path = ROOT, env: dict[str, str] | None = None) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [str(word) for word in command],
        cwd=cwd,
        env=clean_environment() if env is None else env,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=240,
    )


def git_files(*options: str) -> list[str]:
    """Files of the checkout: known to git, or new and not ignored."""
    if shutil.which("git") is None or not (ROOT / ".git").exists():
        pytest.skip("not a git checkout")
    listing = run("git", "ls-files", "-z", *(options or ("--cached", "--others", "--exclude-standard")))
    assert listing.returncode == 0, listing.stderr
    return [name for name in listing.stdout.split("\0") if name and (ROOT / name).exists()]


def setup_arguments(package: str) -> dict[str, Any]:
    """Literal arguments of ``setup()`` in a package's setup.py."""
    tree = ast.parse((ROOT / package / "setup.py").read_text())
    calls = [node for node in ast.walk(tree) if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "setup"]
    arguments = {}
    for keyword in calls[0].keywords:
        try:
            arguments[str(keyword.arg)] = ast.literal_eval(keyword.value)
        except ValueError:
            continue
    return arguments


def pins(python: str) -> dict[str, str]:
    """Pinned version of each package for one version of Python."""
    found: dict[str, str] = {}
    for line in (ROOT / "constraints.txt").read_text().splitlines():
        if not line or line.startswith("#"):
            continue
        pin = Requirement(line)
        assert re.fullmatch(r"==[\w.]+", str(pin.specifier)), f"not one version: {line}"
        if pin.marker is None or pin.marker.evaluate({"python_version": python}):
            name = canonicalize_name(pin.name)
            assert name not in found, f"pinned twice for Python {python}: {name}"
            found[name] = str(pin.specifier)[2:]
    return found


def requirements() -> Iterator[tuple[str, Requirement]]:
    """Requirements of packages and tools, with their locations."""
    for package in PACKAGES:
        arguments = setup_arguments(package)
        texts = list(arguments["install_requires"])
        for extra in arguments["extras_require"].values():
            texts += extra
        texts += tomllib.loads((ROOT / package / "pyproject.toml").read_text())["build-system"]["requires"]
        yield from ((package, Requirement(text)) for text in texts)
    groups = tomllib.loads((ROOT / "pyproject.toml").read_text())["dependency-groups"]
    yield from (("pyproject.toml", Requirement(text)) for text in groups["dev"])


@pytest.fixture
def prefix() -> Path:
    """Virtual environment of `make setup`; skip the test outside of it."""
    prefix = Path(sys.prefix)
    for package in PACKAGES:
        try:
            record = metadata.distribution(package)
        except metadata.PackageNotFoundError:
            pytest.skip(f"{package} is not installed in {prefix}: `make setup`")
        assert str(record.locate_file("")).startswith(str(prefix))
    return prefix


# ---- the commands ---------------------------------------------------------------------------------------------------


def test_make_without_a_target_lists_every_target() -> None:
    listing = run("make")
    assert listing.returncode == 0, listing.stderr
    listed = re.findall(r"^  make ([\w-]+)  +\S", listing.stdout, re.MULTILINE)
    phony = re.search(r"^\.PHONY: (.*)$", (ROOT / "Makefile").read_text(), re.MULTILINE)
    assert phony is not None
    assert sorted(listed) == sorted(phony[1].split())
    assert {"setup", "demo", "up", "test"} <= set(listed)


WORDS = ("o'neil.toml", "two words", 'a"b', "$HOME", "`id`", "#1", "a\\b;c")


@pytest.mark.parametrize("word", WORDS)
def test_values_of_make_variables_reach_the_program_as_they_are(word: str) -> None:
    """With the name of a user, for example, in a path."""
    expected = {
        ("tune", f"CONFIG={word}"): ["--config", word],
        ("up", f"PORT={word}", f"BAUD={word}"): ["--port", word, "--baud", word],
        ("fuzz", f"FUZZ_SECONDS={word}"): ["--seconds", word],
    }
    for arguments, options in expected.items():
        plan = run("make", "--dry-run", *arguments)
        assert plan.returncode == 0, plan.stderr
        assert shlex.split(plan.stdout.splitlines()[-1])[-len(options) :] == options


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ("BOARD=mc56f84789_m4", "for the board odrive36, not for mc56f84789_m4"),
        ("FLASH_TOOL=ls", "FLASH_TOOL is openocd, st-flash or dfu-util, not ls"),
    ],
)
def test_make_flash_refuses_what_it_cannot_write(setting: str, message: str) -> None:
    done = run("make", "--dry-run", "flash", setting)
    assert done.returncode == 2
    assert message in done.stderr


def test_missing_tools_are_named_with_the_command_that_installs_them(tmp_path: Path) -> None:
    for tool in ("sh", "readlink", "uname", "make"):
        (tmp_path / tool).symlink_to(str(shutil.which(tool)))
    check = str(ROOT / ".ci" / "check-tools")
    (tmp_path / "python3").write_text(f'#!/bin/sh\nexec "{sys.executable}" "$@"\n')
    (tmp_path / "python3").chmod(0o755)
    without_gcc = run(tmp_path / "sh", check, env={"PATH": str(tmp_path)})
    assert without_gcc.returncode == 1
    assert re.search(r"sudo apt-get install\b.* gcc\b", without_gcc.stderr)
    (tmp_path / "python3").unlink()
    without_python = run(tmp_path / "sh", check, env={"PATH": str(tmp_path)})
    assert without_python.returncode == 1
    assert re.search(r"sudo apt-get install python3 python3-venv python3-dev\b", without_python.stderr)


# ---- names and versions ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("package", PACKAGES)
def test_package_xml_agrees_with_setup_py(package: str) -> None:
    manifest = ET.parse(ROOT / package / "package.xml").getroot()
    arguments = setup_arguments(package)
    for tag, keyword in (("version", "version"), ("description", "description"), ("license", "license")):
        assert manifest.findtext(tag) == arguments[keyword]
    assert manifest.findtext("maintainer") == arguments["maintainer"]
    assert manifest.findtext("name") == package
    assert manifest.findtext("export/build_type") == "ament_python"
    assert (ROOT / package / "resource" / package).is_file()


def test_all_packages_have_the_same_version() -> None:
    versions = {str(path): ET.parse(path).findtext("version") for path in ROOT.glob("*/package.xml")}
    assert len(versions) == len(PACKAGES) + 1
    build = (ROOT / "firmware" / "CMakeLists.txt").read_text()
    project = re.search(r"^project\(.* VERSION (\S+) ", build, re.MULTILINE)
    assert project is not None
    assert {project[1]} == set(versions.values()), versions


def _imported(package: str) -> list[Path]:
    """`__init__.py` of the packages that a ROS package installs."""
    return sorted((ROOT / package).glob("servo_*/__init__.py"))


@pytest.mark.parametrize("package", PACKAGES)
def test_every_import_is_declared(package: str) -> None:
    manifest = ET.parse(ROOT / package / "package.xml").getroot()
    keys = {str(element.text) for element in manifest if element.tag in ("build_depend", "exec_depend", "depend")}
    declared = set().union(*(MODULES_OF_KEY.get(key, {key.removeprefix("python3-")}) for key in keys))
    neighbours = {folder.parent.name for ours in NEIGHBOURS[package] | {package} for folder in _imported(ours)}
    allowed = (declared - set(PACKAGES)) | neighbours | WITHOUT_KEY[package]
    undeclared = set()
    for path in sorted(path for folder in _imported(package) for path in folder.parent.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text())):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            names += [str(node.module)] if isinstance(node, ast.ImportFrom) else []
            for name in (name.split(".")[0] for name in names):
                if name not in allowed and name not in sys.stdlib_module_names:
                    undeclared.add(f"{path.relative_to(ROOT)}: {name}")
    assert not undeclared


def _anchors(document: Path) -> set[str]:
    """Anchors of the headings, as on code hosts."""
    text = re.sub(r"^```.*?^```", "", document.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    headings = re.findall(r"^#+ +(.*)$", text, re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.strip().lower()).replace(" ", "-") for heading in headings}


def test_every_relative_link_of_the_documents_has_a_target() -> None:
    broken = []
    for document in (ROOT / name for name in git_files() if name.endswith(".md")):
        for target, anchor in re.findall(r"\]\(([^)#:]*)#?([^):]*)\)", document.read_text(encoding="utf-8")):
            path = document.parent / target if target else document
            if not path.exists() or (anchor and anchor not in _anchors(path)):
                broken.append(f"{document.relative_to(ROOT)}: {target}#{anchor}")
    assert not broken


def test_readme_is_short() -> None:
    assert len((ROOT / "README.md").read_text(encoding="utf-8").splitlines()) <= 150


# ---- pinned versions ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("python", PYTHONS)
def test_constraints_satisfy_every_requirement(python: str) -> None:
    pinned = pins(python)
    for where, requirement in requirements():
        name = canonicalize_name(requirement.name)
        if name in map(canonicalize_name, PACKAGES):
            continue
        if requirement.marker is not None and not requirement.marker.evaluate({"python_version": python}):
            continue
        assert name in pinned, f"{where} requires {name}"
        assert requirement.specifier.contains(pinned[name]), f"{where} requires {requirement}"


def test_the_build_of_the_boards_requires_what_the_generators_import() -> None:
    """The build of servo_twin runs programs of servo_msgs_py, without the packages of the installation."""
    build = tomllib.loads((ROOT / "servo_twin" / "pyproject.toml").read_text())["build-system"]["requires"]
    assert set(setup_arguments("servo_msgs_py")["install_requires"]) <= set(build)


def test_generators_find_the_packages_of_an_isolated_build(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """pip passes them in PYTHONPATH."""
    (tmp_path / "path").mkdir()
    started = f"import os\nopen(os.path.join({str(tmp_path)!r}, f'{{os.getpid()}}.started'), 'w').close()\n"
    (tmp_path / "path" / "sitecustomize.py").write_text(started)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path / "path"))
    generated_for("odrive36", tmp_path / "generated")
    assert len([*tmp_path.glob("*.started")]) == 2


# ---- executables ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("package", "name"), EXECUTABLE_NAMES)
def test_executable_is_installed(prefix: Path, package: str, name: str) -> None:
    script = (ROOT / package / "scripts" / name).read_bytes()
    for path in (prefix / "bin" / name, prefix / "lib" / package / name):
        assert path.read_bytes() == script
        assert os.access(path, os.X_OK)


def test_ros_executable_runs_in_the_environment_it_was_installed_into(prefix: Path) -> None:
    # No activated environment: the interpreter is found next to the script, not on the path.
    env = {**clean_environment(), "PATH": os.defpath}
    answer = run(prefix / "lib" / "servo_bridge" / "servo-tool", "--help", env=env)
    assert answer.returncode == 0, answer.stderr


@pytest.mark.parametrize("package", EXECUTABLES)
def test_launch_and_configuration_files_are_installed(prefix: Path, package: str) -> None:
    share = prefix / "share"
    assert (share / "ament_index" / "resource_index" / "packages" / package).exists()
    for pattern in ("package.xml", "launch/*.launch.py", "config/*.yaml", "urdf/*.urdf"):
        for path in (ROOT / package).glob(pattern):
            installed = share / package / path.relative_to(ROOT / package)
            assert installed.read_bytes() == path.read_bytes()


# ---- the checkout ---------------------------------------------------------------------------------------------------


def test_top_level_folders_are_the_documented_ones() -> None:
    assert {name.split("/")[0] for name in git_files() if "/" in name} == FOLDERS


def test_no_ignored_file_is_committed() -> None:
    assert git_files("--cached", "--ignored", "--exclude-standard") == []


def test_no_file_contains_forbidden_text() -> None:
    findings = []
    for name in git_files():
        try:
            text = (ROOT / name).read_text(encoding="utf-8")
        except UnicodeDecodeError:  # binary
            continue
        for what, pattern in UNWANTED.items():
            findings += [f"{name}: {what}: {match[0]}" for match in pattern.finditer(text)]
        hosts = re.findall(r"https?://([\w-]+(?:\.[\w-]+)+)", text)
        findings += [f"{name}: an unexpected host: {host}" for host in hosts if host not in HOSTS]
    assert findings == []


# ---- colcon ---------------------------------------------------------------------------------------------------------

COLLECTED = re.compile(r"^(\d+) tests collected", re.MULTILINE)


@dataclass(frozen=True)
class Workspace:
    """A colcon workspace with copies of the files of the checkout."""

    folder: Path  # root of the workspace; its packages are in ``src``

    def run(self, command: str, folder: str = ".", **environment: str) -> subprocess.CompletedProcess[str]:
        """Run a command line of the shell after the environment of colcon is activated and the workspace is sourced."""
        setup = shlex.quote(str(self.folder / "install" / "setup.sh"))
        path = os.pathsep.join([os.path.join(sys.prefix, "bin"), os.environ["PATH"]])
        env = {**clean_environment(), "PATH": path, **environment}
        return run("bash", "-c", f". {setup} && {command}", cwd=self.folder / folder, env=env)

    def python(self, program: str, folder: str = ".") -> str:
        """Output of a Python program that runs in a folder of the workspace."""
        ended = self.run(f"{shlex.quote(sys.executable)} -c {shlex.quote(program)}", folder)
        assert ended.returncode == 0, ended.stderr
        return ended.stdout.strip()


@pytest.fixture(scope="module")
def workspace(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Workspace:
    """A clean copy of the checkout, built with options of ``colcon build`` from the parameter of the test.

    It has the instrumented C files of the checkout, which would take 10 s, except those of one folder, which the build
    must generate.
    """
    colcon = Path(sys.prefix) / "bin" / "colcon"
    if not colcon.exists() or shutil.which("cmake") is None:
        pytest.skip("colcon or cmake is missing")
    folder = tmp_path_factory.mktemp("workspace")
    for name in git_files():
        (folder / "src" / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / name, folder / "src" / name)
    charged = Path("servo_twin", "build", "charged")
    if (ROOT / charged).is_dir():
        ignored = shutil.ignore_patterns("inputs", "comm")
        shutil.copytree(ROOT / charged, folder / "src" / charged, ignore=ignored)
    # Fast to compile; no test runs it for long. -MD as in the Makefile.
    flags = {"SERVO_TWIN_FLAGS": "-O0 -g0 -fno-lto -MD", "CCACHE_BASEDIR": str(folder)}
    options = getattr(request, "param", None) or ()
    if options:  # the build without options compiles all boards
        flags["SERVO_TWIN_MODULES"] = "ffi"
    build = run(colcon, "build", *options, cwd=folder, env={**clean_environment(), **flags})
    assert build.returncode == 0, build.stdout + build.stderr
    return Workspace(folder)


@pytest.fixture
def pytest_of_ubuntu(prefix: Path) -> dict[str, str]:
    """Environment in which pytest is that of Ubuntu 24.04, and has no plugins."""
    folder = prefix / "pytest-7.4"
    if not folder.exists():
        pytest.skip(f"there is no {folder}: `make lint` installs it")
    return {"PYTHONPATH": str(folder), "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"}


@pytest.mark.slow
@pytest.mark.parametrize("workspace", [["--symlink-install"], None], indirect=True, ids=["links", "copies"])
def test_colcon_builds_the_checkout(workspace: Workspace) -> None:
    """The executables are installed and run, with the compiled board of the workspace."""
    install = workspace.folder / "install"
    for package, name in EXECUTABLE_NAMES:
        assert os.access(install / package / "lib" / package / name, os.X_OK)
    assert (install / "servo_firmware" / "lib" / "libservo_firmware.a").exists()
    native = workspace.python("import servo_bridge.node, servo_twin._native as native; print(native.__file__)")
    assert native.startswith(str(workspace.folder))
    tool = workspace.run("install/servo_bridge/lib/servo_bridge/servo-tool --help")
    assert tool.returncode == 0, tool.stderr


def test_colcon_finds_only_the_packages_of_the_project(prefix: Path) -> None:
    """A package of the tests would hide the package of the same name in the ROS installation."""
    colcon = prefix / "bin" / "colcon"
    if not colcon.exists():
        pytest.skip("colcon is missing")
    found = run(colcon, "--log-base", os.devnull, "list", "--names-only", "--base-paths", ROOT)
    assert found.returncode == 0, found.stderr
    assert sorted(found.stdout.split()) == sorted([*PACKAGES, "servo_firmware"])


@pytest.mark.slow
def test_source_folders_of_a_workspace_have_the_compiled_board(workspace: Workspace) -> None:
    program = "import servo_twin, servo_twin._native as native; print(servo_twin.__file__, native.__file__)"
    package, native = workspace.python(program, "src/servo_twin").split()
    assert package.startswith(str(workspace.folder / "src"))
    assert native.startswith(str(workspace.folder / "install"))


@pytest.mark.slow
def test_programs_of_one_package_find_those_of_another(workspace: Workspace) -> None:
    program = "from servo_twin.processes import executable as e; print(*map(e, ('servo-command', 'servo_twin')))"
    lib = workspace.folder / "install" / "{0}" / "lib" / "{0}"
    expected = [str(lib).format("servo_bridge") + "/servo-command", str(lib).format("servo_twin") + "/servo_twin"]
    assert workspace.python(program).split() == expected


@pytest.mark.slow
@pytest.mark.parametrize(
    ("package", "arguments"),
    [("servo_msgs_py", ()), ("servo_twin", ("test/test_board.py", "-k", "write_and_read or stands_still"))],
)
def test_colcon_tests_with_the_pytest_of_ubuntu(
    workspace: Workspace, pytest_of_ubuntu: dict[str, str], package: str, arguments: tuple[str, ...]
) -> None:
    colcon = Path(sys.prefix) / "bin" / "colcon"
    options = ["--pytest-args", *arguments] if arguments else []
    command = shlex.join([str(colcon), "test", "--packages-select", package, "--return-code-on-test-failure", *options])
    ended = workspace.run(command, **pytest_of_ubuntu)
    log = (workspace.folder / "log" / "latest_test" / package / "stdout_stderr.log").read_text()
    assert ended.returncode == 0, log
    assert "pytest-7.4" in log
    assert re.search(r"== \d+ passed", log)


@pytest.mark.slow
def test_every_test_is_collected_by_the_pytest_of_ubuntu(pytest_of_ubuntu: dict[str, str]) -> None:
    env = {**clean_environment(), **pytest_of_ubuntu}
    # Nothing is executed, hence plain assertions: rewriting them would take 10 s in a fresh checkout.
    options = ("--collect-only", "--quiet", "--assert=plain", "-p", "no:cacheprovider")
    listing = run(sys.executable, "-m", "pytest", *options, env=env)
    assert listing.returncode == 0, listing.stdout[-2000:] + listing.stderr
    found = COLLECTED.search(listing.stdout)
    assert found is not None
    assert int(found[1]) > 1000


def test_the_board_is_linked_with_any_folder_of_temporary_files(tmp_path: Path) -> None:
    """A makefile that gcc writes there for -flto=auto has its name without quotes. The identity is the same."""
    (folder := tmp_path / "it's a folder").mkdir()
    (tmp_path / "one.c").write_text("int other(void);\nint main(void) { return other(); }\n")
    (tmp_path / "other.c").write_text("int other(void) { return 0; }\n")
    code = (
        "import subprocess; from servo_twin._build_native import *; print(build_identity([], OPTIONS)); "
        "raise SystemExit(subprocess.run([*COMPILER, *CFLAGS, 'one.c', 'other.c', '-o', 'program']).returncode)"
    )
    environment = {**clean_environment(), "TMPDIR": str(folder)}
    linked = run(sys.executable, "-c", code, cwd=tmp_path, env=environment)
    assert linked.returncode == 0, linked.stderr
    assert linked.stdout.strip() == build_identity([], OPTIONS)
