"""One mutant against the nearest tests, in a forked child of this process.

The package is copied into a folder of the cache, which the children import it from: the working
tree is never touched, the commands that tests start see the mutant as well, and products of long
runs are kept under the digest of what made them. The copy is made good again at every start.

How long each test takes is measured once a test file and kept; a change of the file or of the code
that it imports measures it again. Kernels are interpreted where the mutant is in one; elsewhere
their machine code is that of before.
"""

import compileall
import contextlib
import ctypes
import json
import os
import re
import resource
import shutil
import signal
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, settings
from mutate import MODULE, Mutant, Plan
from numba.core import config

from surefoot.sim.common.files import kept_file
from surefoot.sim.common.sources import imported_sources, sources_digest

ROOMS = ("sim", "estimator", "models", "scenarios")
LEFT_OUT = "not slow and not long and not pictures"


@dataclass(frozen=True)
class Outcome:
    """How the tests of a mutant ended: survived, killed, timeout (of which killed) or uncovered,
    where no test is quick enough.

    by is the test that failed, files those whose tests ran, seconds of the processor.
    """

    outcome: str
    by: str = ""
    tests: int = 0
    files: tuple[str, ...] = ()
    seconds: float = 0.0


@dataclass(frozen=True)
class Workplace:
    """A checkout and its copy of the package."""

    root: Path
    folder: Path
    plan: Plan

    @property
    def overlay(self) -> Path:
        return self.folder / "overlay"

    def refresh(self) -> None:
        """Make the copy the same as the checkout, stamps too, for machine code is kept by them."""
        sources = [path for room in ROOMS for path in (self.root / room).rglob("*")]
        wanted = {
            self.overlay / "surefoot" / path.relative_to(self.root): path
            for path in sources
            if path.is_file() and "__pycache__" not in path.parts
        }
        for path in (self.root / "surefoot").glob("*.py"):
            wanted[self.overlay / "surefoot" / path.name] = path
        for path in list(self.overlay.rglob("*")):
            if path.is_file() and "__pycache__" not in path.parts and path not in wanted:
                path.unlink()
        for to, path in wanted.items():
            if not to.is_file() or to.read_bytes() != path.read_bytes():
                to.parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(path, to)
        compileall.compile_dir(self.overlay, quiet=2)

    @contextlib.contextmanager
    def mutated(self, mutant: Mutant) -> Iterator[None]:
        """The copy with the mutant in it."""
        path = self.overlay / "surefoot" / mutant.file
        source = self.root / mutant.file
        try:
            path.write_bytes(mutant.apply(source.read_bytes()))
            yield
        finally:
            shutil.copy2(source, path)

    def nearest_tests(self, module: str) -> list[Path]:
        """The nearest test files that import a module in turn: first those that name it, and of
        these and of the others first those that import little else."""
        found = [
            (not _names(path, module), len(sources), path)
            for path, sources in _imports_of_tests(self.root, tuple(self.plan.tests)).items()
            if module in sources or _names(path, module)
        ]
        return [path for *_, path in sorted(found)][: self.plan.nearest]

    def times(self, path: Path, interpreted: bool) -> dict[str, float]:
        """Seconds of the processor of each test of a file that passes in time, quickest first."""
        digest = sources_digest("surefoot.tests." + path.stem, str(path))[:24]
        how = "interpreted" if interpreted else "compiled"
        kept = self.folder / "times" / f"{path.stem}_{how}_{digest}.json"
        if not kept.is_file():
            file = [path.relative_to(self.root).as_posix()]
            if not interpreted:  # once more, so that machine code is there
                self._run_tests(file, interpreted, 5 * self.plan.longest_file)
            _, _, rows = self._run_tests(
                file, interpreted, self.plan.longest_file, self.plan.longest_test
            )
            found = {row["id"]: row["seconds"] for row in rows if row["passed"]}
            with kept_file(kept) as temporary:
                temporary.write_text(json.dumps(found), encoding="utf-8")
        times = json.loads(kept.read_text(encoding="utf-8"))
        return dict(sorted(times.items(), key=lambda one: one[1]))

    def try_mutant(self, mutant: Mutant) -> Outcome:
        """Run the nearest files' tests, of each the quickest within the budget, until one fails."""
        interpreted = _interpreted(mutant, self.root)
        tests, used, files = 0, 0.0, []
        for path in self.nearest_tests(dotted(mutant.file)):
            chosen, needed = [], 0.0
            for name, seconds in self.times(path, interpreted).items():
                needed += seconds
                if needed <= self.plan.budget:
                    chosen.append(name)
            if not chosen:
                continue
            files.append(path.relative_to(self.root).as_posix())
            limit = self.plan.patience * min(needed, self.plan.budget) + self.plan.grace
            with self.mutated(mutant):
                code, seconds, rows = self._run_tests([*chosen, "-x"], interpreted, limit)
            tests, used = tests + len(chosen), used + seconds
            if code:
                timed_out = code in (-signal.SIGXCPU, -signal.SIGKILL)
                failed = [row["id"] for row in rows if not row["passed"]]
                # Without a failed test it fell at the import, or took the process with it.
                by = failed[0] if failed and not timed_out else files[-1]
                outcome = "timeout" if timed_out else "killed"
                return Outcome(outcome, by, tests, (files[-1],), round(used, 2))
        outcome = "survived" if files else "uncovered"
        return Outcome(outcome, "", tests, tuple(files), round(used, 2))

    def _run_tests(
        self, tests: list[str], interpreted: bool, limit: float, longest: float = 0.0
    ) -> tuple[int, float, list[dict[str, Any]]]:
        """Exit code, seconds of the processor, and a row for each test that ended, of a forked
        child that imports the copy; a test is stopped after `longest` seconds, 0 for never."""
        results = self.folder / f"results_{os.getpid()}.jsonl"
        results.write_text("", encoding="utf-8")
        sys.stdout.flush()
        child = os.fork()
        if child == 0:
            code = 70
            try:
                os.setpgid(0, 0)
                self._enter(interpreted, limit)
                fixed = ["-p", "no:cacheprovider", "-p", "no:xdist", f"--rootdir={self.root}"]
                fixed += ["-q", "--tb=line", "-m", LEFT_OUT]
                code = int(pytest.main([*tests, *fixed], [_Results(results, longest)]))
            except BaseException as error:
                print(repr(error), file=sys.stderr)
            finally:
                sys.stdout.flush()
                os._exit(code)
        with contextlib.suppress(OSError):
            os.setpgid(child, child)
        try:
            ended, status, used = 0, 0, None
            until = time.monotonic() + 20 * limit  # processor time counts, but for sleep
            while not ended:
                ended, status, used = os.wait4(child, os.WNOHANG)
                if not ended and time.monotonic() > until:
                    os.kill(child, signal.SIGKILL)
                if not ended:
                    time.sleep(0.01)
        finally:
            with contextlib.suppress(OSError):
                os.killpg(child, signal.SIGKILL)  # what its tests left running
        assert used is not None
        lines = results.read_text(encoding="utf-8").splitlines()
        results.unlink()
        seconds = used.ru_utime + used.ru_stime
        return os.waitstatus_to_exitcode(status), seconds, [json.loads(line) for line in lines]

    def _enter(self, interpreted: bool, limit: float) -> None:
        """In a child: limits, and the copy of the package in the place of this process' own."""
        if sys.platform == "linux":
            ctypes.CDLL(None).prctl(1, signal.SIGKILL)  # PR_SET_PDEATHSIG: end with the parent
        seconds = int(limit) + 1
        resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds + 2))
        pages = int(Path("/proc/self/statm").read_text().split()[0])
        most = pages * resource.getpagesize() + self.plan.memory
        resource.setrlimit(resource.RLIMIT_AS, (most, most))
        log = os.open(self.folder / "last.log", os.O_CREAT | os.O_TRUNC | os.O_WRONLY)
        os.dup2(log, 1)
        os.dup2(log, 2)
        os.chdir(self.root)
        digests = {n: sources_digest(n) for n in _kernel_sources(self.root)}
        for name in [n for n in sys.modules if n.partition(".")[0] == "surefoot"]:
            del sys.modules[name]
        sys.dont_write_bytecode = True
        sys.path[:] = [str(self.overlay), *(p for p in sys.path if Path(p) != self.root)]
        os.environ |= {
            "PYTHONPATH": str(self.overlay),
            "PYTHONDONTWRITEBYTECODE": "1",
            "SUREFOOT_CACHE": str(self.folder / "cache"),
            "NUMBA_DISABLE_JIT": str(int(interpreted)),
        }
        config.DISABLE_JIT = int(interpreted)
        # A loaded machine fails no test, and chance none.
        checks = {"deadline": None, "suppress_health_check": list(HealthCheck)}
        settings.register_profile("mutants", derandomize=True, database=None, **checks)
        settings.load_profile("mutants")
        if digests and not interpreted:
            import surefoot.sim.common.kernels as kernels

            now = kernels.sources_digest
            kernels.sources_digest = lambda name, file=None: digests.get(name) or now(name, file)


class _TooLong(Exception):
    pass


class _Results:
    """Plugin of pytest: writes a row for each test that ended."""

    def __init__(self, rows: Path, longest: float):
        self.rows = rows
        self.longest = longest
        self.passed = True
        signal.signal(signal.SIGPROF, self._stop)

    def _stop(self, number: int, frame: Any) -> None:
        raise _TooLong

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_call(self, item: Any) -> Iterator[None]:
        signal.setitimer(signal.ITIMER_PROF, self.longest)
        try:
            return (yield)
        finally:
            signal.setitimer(signal.ITIMER_PROF, 0.0)

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: Any) -> Iterator[Any]:
        self.passed, start = True, time.process_time()
        result = yield
        seconds = round(time.process_time() - start, 3)
        with self.rows.open("a", encoding="utf-8") as file:
            row = {"id": item.nodeid, "seconds": seconds, "passed": self.passed}
            file.write(json.dumps(row) + "\n")
        return result

    def pytest_runtest_logreport(self, report: Any) -> None:
        self.passed &= report.passed


def dotted(file: str) -> str:
    """The module of a file of a room."""
    return "surefoot." + file.removesuffix(".py").replace("/", ".").removesuffix(".__init__")


def _interpreted(mutant: Mutant, root: Path) -> bool:
    """Whether a mutant is in kernels, or in what is made at the import of a module of theirs."""
    kernels, module = _kernel_sources(root), dotted(mutant.file)
    made_at_import = mutant.scope == MODULE and any(module in one for one in kernels.values())
    return module in kernels or made_at_import


@cache
def _imports_of_tests(root: Path, folders: tuple[str, ...]) -> dict[Path, frozenset[str]]:
    """Test file -> modules that it imports in turn."""
    paths = [path for folder in folders for path in sorted((root / folder).rglob("test_*.py"))]
    return {
        path: frozenset(imported_sources("surefoot.tests." + path.stem, str(path)))
        for path in paths
    }


@cache
def _names(path: Path, module: str) -> bool:
    """Whether a source names a module."""
    package, _, last = module.rpartition(".")
    text = path.read_text(encoding="utf-8")
    apart = rf"from {re.escape(package)} import [^\n]*\b{last}\b"
    return re.search(rf"{re.escape(module)}\b|{apart}", text) is not None


@cache
def _kernel_sources(root: Path) -> dict[str, frozenset[str]]:
    """Module with kernels -> modules that it imports in turn."""
    found = {}
    for path in (path for room in ROOMS for path in sorted((root / room).rglob("*.py"))):
        if "from surefoot.sim.common.kernels import" in path.read_text(encoding="utf-8"):
            name = dotted(path.relative_to(root).as_posix())
            found[name] = frozenset(imported_sources(name))
    return found
