"""Digests of code: of the files that dvc.yaml lists for a stage, and of nothing else."""

from __future__ import annotations

import pytest

from stages.common import code

PIPELINE = """
stages:
  one:
    foreach: ${scenes}
    do:
      cmd: a
      deps: [lib, stages/one.py, "results/${item}/scene"]
  other:
    cmd: b
    deps: [stages/other.py]
"""
FILES = ("lib/a.py", "lib/b.py", "lib/data.yaml", "stages/one.py", "stages/other.py")


@pytest.fixture
def project(tmp_path, monkeypatch):
    for name in FILES:
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(f"# {name}\n")
    (tmp_path / "dvc.yaml").write_text(PIPELINE)
    monkeypatch.setattr(code, "PROJECT", tmp_path)
    # What a process has found it keeps.
    forget()
    yield tmp_path
    forget()


def forget() -> None:
    code.digest_of.cache_clear()
    code.code_of.cache_clear()


def test_the_python_files_among_the_dependencies(project):
    names = [path.relative_to(project).as_posix() for path in code.code_of("one")]
    assert names == ["lib/a.py", "lib/b.py", "stages/one.py"]
    assert code.code_of("other") == (project / "stages/other.py",)


@pytest.mark.parametrize("file", FILES)
def test_a_digest_changes_with_each_of_them_alone(project, file):
    before = [code.digest_of(*names) for names in (("one",), ("other",), ("one", "other"))]
    assert len(set(before)) == 3
    (project / file).write_text("# changed\n")
    assert code.digest_of("one") == before[0]  # as it was when the process first asked
    forget()
    of_one, of_other = file in (FILES[0], FILES[1], FILES[3]), file == FILES[4]
    after = [code.digest_of(*names) for names in (("one",), ("other",), ("one", "other"))]
    changed = [new != old for new, old in zip(after, before, strict=True)]
    assert changed == [of_one, of_other, of_one or of_other]


def test_a_file_that_is_renamed_is_another(project):
    before = code.digest_of("one")
    (project / "lib/b.py").rename(project / "lib/c.py")
    forget()
    assert code.digest_of("one") != before
