"""Kernels compiled from sources that have changed since are forgotten, others are kept."""

from sim.kernel_cache import forget_stale_kernels


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
