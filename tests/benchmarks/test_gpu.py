"""`make gpu`, on the CPU and with small pictures; without a GPU it says so."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

import benchmarks.__main__ as bench
from benchmarks import gpu
from benchmarks.cli import make_app


@pytest.mark.slow
def test_it_fits_a_scene_measures_and_runs_tests(monkeypatch, capfd):
    wrote = []
    monkeypatch.setattr(bench, "rows", lambda: [bench.pass_row(32, radius=0.05)])
    monkeypatch.setattr(gpu, "write_png", lambda path, image, _: wrote.append((path, image.shape)))
    words = ["--variant", "llvm_ad_rgb", "--rows", "64", "--seconds", "6"]
    with pytest.raises(SystemExit) as end:
        make_app(gpu.gpu)([*words, "--folders", "core/test_morton.py"])
    told = capfd.readouterr().out
    assert end.value.code == 0 and re.search(r"\d passed", told)
    assert wrote == [(Path("results/gpu.png"), (64, 64, 3))]
    assert float(re.search(r"differ by ([\d.]+) dB", told)[1]) > 25
    assert float(re.search(r"\(gpf, recorded\), 64², vs path \((\d+) frames/s\)", told)[1]) > 1
    assert "SPPM pass, 32²" in told  # what `make bench` prints


def test_a_failed_test_is_a_failure(tmp_path):
    (tmp_path / "tests" / "bad").mkdir(parents=True)
    (tmp_path / "tests" / "bad" / "test_bad.py").write_text("def test_it():\n    assert False\n")
    code = "from benchmarks.gpu import run_tests; raise SystemExit(run_tests(['bad']))"
    root = {"PYTHONPATH": str(Path(gpu.__file__).parents[1])}
    run = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, env=root, check=False)
    assert run.returncode == 1
