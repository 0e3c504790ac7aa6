"""Run code that may kill its process in a subprocess."""

import json
import subprocess
import sys
from typing import Any

# LLVM 15 and 16 cannot compile `minimum`. The sum is 0+1+2+3+3.5+3.5+3.5+3.5 = 20.
PROBE = """
import json
import gpf
import drjit as dr
from gpf.core.runtime import LLVM_MINIMUM

def run(module):
    return dr.sum(dr.minimum(dr.arange(module.Float, 8), 3.5))[0]

has_cuda = bool(dr.has_backend(dr.JitBackend.CUDA))
llvm = dr.detail.llvm_version()
print(json.dumps({"llvm": llvm, "cuda": has_cuda}), flush=True)
if has_cuda:
    import drjit.cuda
    print(json.dumps({"cuda_sum": run(drjit.cuda)}), flush=True)
if llvm[0] >= LLVM_MINIMUM:
    import drjit.llvm
    print(json.dumps({"llvm_sum": run(drjit.llvm)}), flush=True)
"""
PROBE_SUM = 20.0
TIMEOUT = 60.0
"""Seconds after which a subprocess is killed."""


def run_probe() -> dict[str, Any]:
    """Run a small kernel on each backend in a subprocess.

    Returns ``llvm`` (version), ``cuda`` (whether Dr.Jit has it), ``llvm_sum`` and ``cuda_sum``
    (results, :data:`PROBE_SUM` if correct), as far as the subprocess got, and ``died`` (its signal
    or error) if it failed.
    """
    answer: dict[str, Any] = {}
    status, output, errors = run_python(PROBE)
    for line in output.splitlines():
        if line.startswith("{"):
            answer |= json.loads(line)
    if status != 0:
        answer["died"] = f"signal {-status}" if status < 0 else last_line(errors)
    return answer


def run_python(code: str) -> tuple[int, str, str]:
    """Run ``code`` in a new interpreter.

    Returns its exit status (negative: ended by that signal), its output and its errors. A
    subprocess that is killed after :data:`TIMEOUT` has status 1.
    """
    with subprocess.Popen(
        [sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        try:
            output, errors = process.communicate(timeout=TIMEOUT)
        except subprocess.TimeoutExpired:
            process.kill()
            output, _ = process.communicate()  # what it wrote before it was killed
            return 1, output, f"no answer within {TIMEOUT:g} seconds"
        return process.returncode, output, errors


def last_line(text: str) -> str:
    """The last line of a traceback: the error itself."""
    lines = text.strip().splitlines()
    return lines[-1] if lines else "no message"
