"""Kernels compiled from sources that have changed since are forgotten, others are kept."""

from surefoot.sim.common.kernels import forget_stale_kernels


def test_kernels_live_as_long_as_their_sources(tmp_path):
    init = tmp_path / "__init__.py"
    init.write_text("")
    helper = tmp_path / "helper.py"
    helper.write_text("a = 1\n")
    cache = tmp_path / "__pycache__"
    cache.mkdir()

    def compiled():
        kernel = cache / "caller.kernel-1.py311.nbi"
        kernel.write_bytes(b"")
        return kernel

    forget_stale_kernels(str(init))
    kernel = compiled()
    forget_stale_kernels(str(init))
    assert kernel.exists()
    helper.write_text("a = 2\n")
    forget_stale_kernels(str(init))
    assert not kernel.exists()


def test_a_read_only_installation_is_left_alone(tmp_path):
    (tmp_path / "__init__.py").write_text("")
    (tmp_path / "__pycache__").write_text("not a folder")
    forget_stale_kernels(str(tmp_path / "__init__.py"))


def test_kernels_die_with_the_sources_of_other_packages_that_they_call(tmp_path):
    inits = []
    for name in ("caller", "called"):
        (tmp_path / name).mkdir()
        inits.append(tmp_path / name / "__init__.py")
        inits[-1].write_text("")
    cache = tmp_path / "caller" / "__pycache__"
    cache.mkdir()
    kernel = cache / "batch.run-1.py311.nbi"
    forget_stale_kernels(*map(str, inits))
    kernel.write_bytes(b"")
    forget_stale_kernels(*map(str, inits))
    assert kernel.exists()
    inits[1].write_text("a = 2\n")
    forget_stale_kernels(*map(str, inits))
    assert not kernel.exists()
