"""What the programs that run published code see to, without such code."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from baselines.official import PROGRAMS
from tests.baselines.adapters import load_program, write_weights

conversation = load_program("conversation")


class Network(torch.nn.Module):
    """As networks of the hub load: what the file lacks, they keep."""

    def __init__(self) -> None:
        super().__init__()
        self.first, self.second = torch.nn.Linear(2, 3), torch.nn.Linear(3, 1)

    @classmethod
    def from_pretrained(cls, folder: str) -> Network:
        from safetensors.torch import load_file

        network = cls()
        network.load_state_dict(load_file(f"{folder}/model.safetensors"), strict=False)
        return network


def tensors() -> dict[str, Any]:
    return {name: np.ones(value.shape) for name, value in Network().state_dict().items()}


def test_weights_that_fit_are_loaded(tmp_path: Path) -> None:
    folder = conversation.find_weights(write_weights(tmp_path / "good", tensors()))
    network = conversation.load_network(Network, folder)
    assert not network.training and (network.first.weight == 1).all()


def test_tensors_that_are_missing_are_not_left_random(tmp_path: Path) -> None:
    some = {name: value for name, value in tensors().items() if "second" not in name}
    folder = Path(write_weights(tmp_path / "some", some))
    with pytest.raises(conversation.Refusal, match="2 tensors are missing, among them second.bias"):
        conversation.load_network(Network, folder)


@pytest.mark.parametrize("damage", ["shape", "file"])
def test_weights_of_another_shape_or_cut_short_are_refused(tmp_path: Path, damage: str) -> None:
    folder = Path(write_weights(tmp_path / "bad", tensors() | {"first.bias": np.ones(4)}))
    if damage == "file":
        file = folder / "model.safetensors"
        file.write_bytes(file.read_bytes()[:-8])
    words = "size mismatch for first.bias" if damage == "shape" else "weights do not fit"
    with pytest.raises(conversation.Refusal, match=words):
        conversation.load_network(Network, folder)


def test_what_the_network_itself_looks_for_in_vain_is_no_matter_of_its_weights(
    tmp_path: Path,
) -> None:
    class Impatient(Network):
        @classmethod
        def from_pretrained(cls, folder: str) -> Network:
            raise FileNotFoundError("another network's weights")

    with pytest.raises(FileNotFoundError, match="another network"):
        conversation.load_network(Impatient, Path(write_weights(tmp_path / "any", tensors())))


def test_only_answers_come_out_however_much_is_printed(tmp_path: Path) -> None:
    program = tmp_path / "program.py"
    program.write_text(
        f"""
import os, sys
sys.path.insert(0, {str(PROGRAMS)!r})
from conversation import Refusal, converse

def start(request):
    print("loading", request["what"])
    os.system("echo and so does its child")
    def respond(request):
        if request["n"] < 0:
            raise Refusal("too little", "Give more.")
        return {{"twice": 2 * request["n"], "path": sys.path[0]}}
    return respond, {{"device": "none"}}

converse(start)
"""
    )
    requests = [{"what": "it", "code": "/nowhere/in/particular"}, {"n": 3}, {"n": -1}, {"n": 4}]
    done = subprocess.run(
        [sys.executable, str(program)],
        input="".join(json.dumps(request) + "\n" for request in requests),
        capture_output=True,
        text=True,
        check=True,
    )
    answers = [json.loads(line) for line in done.stdout.splitlines()]
    assert answers == [
        {"device": "none"},
        {"twice": 6, "path": "/nowhere/in/particular"},
        {"refused": "too little", "todo": "Give more."},
        {"twice": 8, "path": "/nowhere/in/particular"},
    ]
    assert "loading it" in done.stderr and "and so does its child" in done.stderr
