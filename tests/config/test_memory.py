"""Numbers that need more memory than there is are told before anything starts."""

from __future__ import annotations

import resource

import pytest

from gpf.core import machine
from gpf.core.errors import UserError
from gpf.core.machine import count_memory, require_memory
from stages.config.memory import BYTES, refuse_too_large
from stages.config.params import Params

MUCH = 2**31 - 1


def test_the_defaults_need_little(monkeypatch):
    monkeypatch.setattr(machine, "count_memory", lambda: 2**27)
    refuse_too_large(Params(scenes=("a",)))


@pytest.mark.parametrize("key", BYTES)
def test_what_needs_too_much_says_how_much(monkeypatch, key):
    monkeypatch.setattr(machine, "count_memory", lambda: 2**34)
    params = Params(scenes=("a",)).vary({key: MUCH})
    gigabytes = MUCH * BYTES[key] / 2**30
    words = rf"params\.yaml: {key}: is 2,147,483,647, which needs at least {gigabytes:.1f} GiB"
    with pytest.raises(UserError, match=words):
        refuse_too_large(params)


def test_rows_of_baselines_are_checked(monkeypatch):
    monkeypatch.setattr(machine, "count_memory", lambda: 2**34)
    rows = {"many": {"system": "sppm", "photons_per_pass": MUCH}}
    with pytest.raises(UserError, match=r"baselines\.many\.photons_per_pass: is 2,147,483,647"):
        refuse_too_large(Params(scenes=("a",), baselines=rows))


def test_a_limit_of_the_process_counts(monkeypatch):
    limits = {resource.RLIMIT_AS: (2**32, resource.RLIM_INFINITY)}
    monkeypatch.setattr(resource, "getrlimit", limits.__getitem__)
    assert count_memory() == 2**32
    require_memory("--size", "4x4", 2**32)
    with pytest.raises(
        UserError, match=r"--size: is 9x9, which needs at least 8\.0 GiB .* 4\.0 GiB are available"
    ):
        require_memory("--size", "9x9", 2**33)


@pytest.mark.parametrize("value", [2**31, 10**30])
def test_numbers_beyond_32_bits_are_told(value):
    for key in ("reference.photons_per_pass", "train.steps", "render.spp", "photons.paths"):
        with pytest.raises(ValueError, match=r"2147483648|2147483647"):
            Params(scenes=("a",)).vary({key: value})
