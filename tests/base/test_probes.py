"""What works on this machine is tried where it can do no harm."""

from pathlib import Path

import pytest

from kinran.base import probes


def test_a_variant_that_works_and_those_that_do_not(monkeypatch: pytest.MonkeyPatch) -> None:
    assert probes.variant_fault("scalar_rgb") == ""
    assert "scalar_none" in probes.variant_fault("scalar_none")
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", "/nonexistent/libLLVM.so")
    assert "could not be found" in probes.variant_fault()


def test_a_library_that_aborts_the_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """LLVM 15 works for literals, which are never compiled, and aborts on anything else."""
    library = next(Path("/usr/lib").glob("*/libLLVM-15.so.1"), None)
    if library is None:
        pytest.skip("LLVM 15 is not installed here")
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", str(library))
    assert "aborts" in probes.variant_fault()


def test_pymeshlab_lacks_plugins(monkeypatch: pytest.MonkeyPatch) -> None:
    assert probes.pymeshlab_fault() == ""
    monkeypatch.setattr(probes, "PYMESHLAB_PLUGINS", 999)
    assert probes.pymeshlab_fault() == "58 of 999 plugins"
