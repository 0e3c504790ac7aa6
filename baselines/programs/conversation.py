"""Messages between a program and the process that started it: one line of JSON each."""

from __future__ import annotations

import importlib
import json
import os
import resource
import sys
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any

Answer = dict[str, Any]

MEND = "Download them again, or correct the option `weights`."


class Refusal(Exception):
    """A request that cannot be answered: ``what`` is wrong; ``todo`` is what the user can do."""

    def __init__(self, what: str, todo: str) -> None:
        super().__init__(what)
        self.what, self.todo = what, todo


def converse(start: Callable[[Answer], tuple[Callable[[Answer], Answer], Answer]]) -> None:
    """Answer requests from standard input until it ends.

    ``start`` takes the first request; it returns a function for all further requests, and the
    answer to the first. All other output is sent to standard error, so that standard output has
    only answers.
    """
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    respond = None
    for line in sys.stdin:
        request = json.loads(line)
        try:
            if respond is None:
                sys.path[:0] = [request["code"]] if "code" in request else []
                respond, answer = start(request)
            else:
                answer = respond(request)
        except Refusal as refusal:
            answer = {"refused": refusal.what, "todo": refusal.todo}
        answers.write(json.dumps(answer) + "\n")
        answers.flush()


def find_weights(name: str) -> Path:
    """The folder of the weights: a folder of this name, or the hub's copy in the local cache.

    Raises
    ------
    Refusal: there is no such folder, or a file is missing from it.
    """
    folder = Path(name)
    if not folder.is_dir():
        folder = _find_in_cache(name)
    for file in ("config.json", "model.safetensors"):
        if not (folder / file).is_file():
            raise Refusal(f"weights not installed: {name} has no {file}", MEND)
    return folder


def _find_in_cache(name: str) -> Path:
    try:
        hub = importlib.import_module("huggingface_hub")
        return Path(hub.snapshot_download(name, local_files_only=True))
    except Exception as error:  # an unknown name and an empty cache raise different errors
        traceback.print_exc()
        raise Refusal(
            f"weights not installed: {name}",
            f"{say_how_to_download(name)}, or set the option `weights` to a folder that has "
            "config.json and model.safetensors.",
        ) from error


def say_how_to_download(name: str) -> str:
    """The command that downloads weights from the hub into the cache."""
    return f"Run `pip install huggingface_hub && hf download {name}` with network access"


def load_network(network: Any, folder: Path) -> Any:
    """Call ``network.from_pretrained``, then check for missing tensors, which it ignores.

    Raises
    ------
    Refusal: tensors are missing, or their shapes differ from the network's.
    OSError: a file that the network's own code needs is missing.
    """
    try:
        model = network.from_pretrained(str(folder))
    except OSError:
        raise
    except Exception as error:  # torch, safetensors and the networks raise several kinds
        traceback.print_exc()
        lines = [line.strip() for line in str(error).splitlines() if line.strip()]
        detail = next((line for line in lines if "size mismatch" in line), (lines or ["?"])[-1])
        raise Refusal(f"weights do not fit the network: {detail.rstrip('.')}", MEND) from error
    with importlib.import_module("safetensors").safe_open(
        str(folder / "model.safetensors"), framework="np"
    ) as stored:
        missing = sorted({key for key, _ in model.named_parameters()} - set(stored.keys()))
    if missing:  # these parameters would stay random
        raise Refusal(
            f"weights do not fit the network: {len(missing)} tensors are missing, among them "
            f"{missing[0]}",
            MEND,
        )
    return model.eval()


def describe(model: Any, device: str) -> Answer:
    """Device and number of parameters of a loaded network."""
    return {"device": device, "parameters": sum(p.numel() for p in model.parameters())}


def peak_megabytes() -> float:
    """The peak memory of this process, megabytes."""
    unit = 1 if sys.platform == "darwin" else 1024  # macOS counts bytes, Linux kibibytes
    return unit * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
