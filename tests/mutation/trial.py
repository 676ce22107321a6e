"""One mutant against the tests that cover it, in a forked child of this process.

The package is copied into a folder of the cache, which the children import it from: the working
tree is never touched, the commands that tests start see the mutant as well, and products of long
runs are kept under the digest of what made them. The copy is made good again at every start.

Which functions a test calls is recorded once a test file and kept; a change of the file or of the
code that it imports makes it again. Kernels are interpreted where the mutant is in one; elsewhere
their machine code is that of before.
"""

import compileall
import contextlib
import ctypes
import inspect
import json
import os
import re
import resource
import shutil
import signal
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, settings
from mutate import MODULE, Mutant
from numba.core import config, event
from plan import Plan

from surefoot.sim.common.files import kept_file
from surefoot.sim.common.sources import imported_sources, sources_digest

ROOMS = ("sim", "estimator", "models", "scenarios")
KERNELS = "surefoot.sim.common.kernels"
LEFT_OUT = "not slow and not long and not pictures"


@dataclass(frozen=True)
class Covering:
    """A test: its id, its seconds of the processor, and the functions that it calls, as
    "file:qualified name"."""

    id: str
    seconds: float
    functions: frozenset[str]


@dataclass(frozen=True)
class Outcome:
    """How the tests of a mutant ended: survived, killed, timeout (of which killed) or uncovered.

    by is the test that failed, files those whose tests ran, seconds of the processor.
    """

    outcome: str
    by: str = ""
    tests: int = 0
    files: tuple[str, ...] = ()
    seconds: float = 0.0


@dataclass(frozen=True)
class Workplace:
    """A checkout, its copy of the package, and what is known of its tests."""

    root: Path
    folder: Path
    plan: Plan
    known: dict[tuple[str, bool], list[Covering]] = field(default_factory=dict)

    @property
    def overlay(self) -> Path:
        return self.folder / "overlay"

    def refresh(self) -> None:
        """Make the copy the same as the checkout, stamps too, for machine code is kept by them."""
        wanted: dict[Path, Path] = {}
        for room in ROOMS:
            for path in (self.root / room).rglob("*"):
                if path.is_file() and "__pycache__" not in path.parts:
                    wanted[self.overlay / "surefoot" / path.relative_to(self.root)] = path
        for path in (self.root / "surefoot").glob("*.py"):
            wanted[self.overlay / "surefoot" / path.name] = path
        for path in list((self.overlay).rglob("*")):
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
        """Test files that import a module in turn: first those that name it, then those that name
        a module that does, and of these first those that import little else."""
        beside = [name for name, path in _modules(self.root).items() if _names(path, module)]
        found = []
        for path, sources in _imports_of_tests(self.root, tuple(self.plan.tests)).items():
            named = _names(path, module)
            if named or module in sources:
                near = any(_names(path, name) for name in beside)
                found.append((0 if named else 1 if near else 2, len(sources), path))
        return [path for *_, path in sorted(found)]

    def covering(self, path: Path, interpreted: bool) -> list[Covering]:
        """The tests of a file that pass in time, and what they call."""
        name = path.relative_to(self.root).as_posix()
        if (name, interpreted) not in self.known:
            digest = sources_digest("surefoot.tests." + path.stem, str(path))[:24]
            how = "interpreted" if interpreted else "compiled"
            kept = self.folder / "calls" / f"{path.stem}_{how}_{digest}.json"
            if not kept.is_file():
                rows = self._record(name, interpreted)
                with kept_file(kept) as temporary:
                    temporary.write_text(json.dumps(rows), encoding="utf-8")
            self.known[name, interpreted] = [
                Covering(row["id"], row["seconds"], frozenset(row["functions"]))
                for row in json.loads(kept.read_text(encoding="utf-8"))
            ]
        return self.known[name, interpreted]

    def _record(self, name: str, interpreted: bool) -> list[dict[str, Any]]:
        rows = self.folder / f"calls_{os.getpid()}.jsonl"
        rows.unlink(missing_ok=True)
        longest = self.plan.longest_test
        recorder = _Recorder(self.overlay / "surefoot", rows, longest, stop=interpreted)
        # Machine code that is not there yet is made in the first of the tests that need it.
        limit = self.plan.longest_file if interpreted else 5 * self.plan.longest_file
        self._forked(lambda: _pytest(self.root, [name], [recorder]), interpreted, limit)
        text = rows.read_text(encoding="utf-8") if rows.is_file() else ""
        rows.unlink(missing_ok=True)
        return [json.loads(line) for line in text.splitlines()]

    def try_mutant(self, mutant: Mutant) -> Outcome:
        """Run the tests that cover a mutant, those of the nearest files first, until one fails."""
        interpreted = self._interpreted(mutant)
        tests, used, files = 0, 0.0, []
        for path, chosen in self._chosen(mutant, interpreted):
            files.append(path.relative_to(self.root).as_posix())
            tests += len(chosen)
            limit = self.plan.patience * sum(test.seconds for test in chosen) + self.plan.grace
            failed, seconds = self._run_tests(mutant, chosen, interpreted, limit)
            used += seconds
            if failed is not None:
                outcome = "timeout" if failed == "timeout" else "killed"
                by = files[-1] if failed == "timeout" else failed
                return Outcome(outcome, by, tests, (files[-1],), round(used, 2))
        outcome = "survived" if files else "uncovered"
        return Outcome(outcome, "", tests, tuple(files), round(used, 2))

    def _chosen(self, mutant: Mutant, interpreted: bool) -> Iterator[tuple[Path, list[Covering]]]:
        """Tests that cover a mutant by file: the quickest of all files, as far as the budget goes,
        and one at least."""
        nearest = self.nearest_tests(dotted(mutant.file))[: self.plan.nearest]
        covering = [
            (test.seconds, place, test)
            for place, path in enumerate(nearest)
            for test in self.covering(path, interpreted)
            if _covers(test, mutant)
        ]
        chosen: dict[int, list[Covering]] = {}
        left = self.plan.budget
        for seconds, place, test in sorted(covering, key=lambda one: one[:2]):
            if seconds > left and chosen:
                break
            chosen.setdefault(place, []).append(test)
            left -= seconds
        for place, tests in sorted(chosen.items()):
            yield nearest[place], tests

    def _run_tests(
        self, mutant: Mutant, tests: list[Covering], interpreted: bool, limit: float
    ) -> tuple[str | None, float]:
        """The first test that fails, None where none does, and the seconds used."""
        said = self.folder / f"failed_{os.getpid()}"
        said.unlink(missing_ok=True)
        ids = [test.id for test in tests]
        watcher = _Watcher(said)
        with self.mutated(mutant):
            code, seconds = self._forked(
                lambda: _pytest(self.root, [*ids, "-x"], [watcher]), interpreted, limit
            )
        failed = said.read_text(encoding="utf-8") if said.is_file() else ""
        said.unlink(missing_ok=True)
        if code == 0:
            return None, seconds
        if code == -signal.SIGXCPU or code == -signal.SIGKILL:
            return "timeout", seconds
        # Without a failed test it fell at the import, or took the process with it.
        return failed or ids[0].partition("::")[0], seconds

    def _interpreted(self, mutant: Mutant) -> bool:
        kernels = _kernel_sources(self.root)
        module = dotted(mutant.file)
        seen = mutant.scope == MODULE and any(module in one for one in kernels.values())
        return module in kernels or seen

    def _forked(self, run: Callable[[], int], interpreted: bool, limit: float) -> tuple[int, float]:
        """Exit code and seconds of the processor of a forked child, which imports the copy."""
        sys.stdout.flush()
        child = os.fork()
        if child == 0:
            code = 70
            try:
                os.setpgid(0, 0)
                self._enter(interpreted, limit)
                code = int(run())
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
        return os.waitstatus_to_exitcode(status), used.ru_utime + used.ru_stime

    def _enter(self, interpreted: bool, limit: float) -> None:
        """In a child: limits, and the copy of the package in the place of this process' own."""
        if sys.platform == "linux":
            ctypes.CDLL(None).prctl(1, signal.SIGKILL)  # PR_SET_PDEATHSIG: end with the parent
        seconds = int(limit) + 1
        resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds + 2))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
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
        }
        os.environ["NUMBA_DISABLE_JIT"] = str(int(interpreted))
        config.DISABLE_JIT = int(interpreted)
        # A loaded machine fails no test, and chance none.
        checks = {"deadline": None, "suppress_health_check": list(HealthCheck)}
        settings.register_profile("mutants", derandomize=True, database=None, **checks)
        settings.load_profile("mutants")
        if digests and not interpreted:
            import surefoot.sim.common.kernels as kernels

            now = kernels.sources_digest
            kernels.sources_digest = lambda name, file=None: digests.get(name) or now(name, file)


_LOCALS = ".<locals>"


def _covers(test: Covering, mutant: Mutant) -> bool:
    """Whether a test calls the mutated function; of what is made at the import, which functions of
    the module read, whether it calls one of them."""
    if mutant.scope == MODULE:
        return any(function.startswith(f"{mutant.file}:") for function in test.functions)
    # A function inside an `if` of another has no mark of it in its scope.
    scope = f"{mutant.file}:{mutant.scope}".replace(_LOCALS, "")
    return any(function.replace(_LOCALS, "") == scope for function in test.functions)


class _TooLong(Exception):
    pass


class _Recorder:
    """Plugin of pytest: a row for each test that passes in time."""

    def __init__(self, package: Path, rows: Path, longest: float, stop: bool):
        self.package = f"{package}/"
        self.rows = rows
        self.longest = longest
        self.stop = stop
        self.shared: set[str] = set()
        self.called: set[str] = set()
        self.passed = True

    def _trace(self, frame: Any, event: str, argument: Any) -> None:
        code = frame.f_code
        if code.co_flags & inspect.CO_OPTIMIZED and code.co_filename.startswith(self.package):
            self.called.add(f"{code.co_filename[len(self.package) :]}:{code.co_qualname}")

    @pytest.hookimpl(hookwrapper=True)
    def pytest_collection(self) -> Iterator[None]:
        sys.settrace(self._trace)
        yield
        sys.settrace(None)
        self.shared |= self.called

    @pytest.hookimpl(hookwrapper=True)
    def pytest_runtest_protocol(self, item: Any) -> Iterator[None]:
        self.called, self.passed = set(), True
        compiling = _Compiling()
        start = time.process_time()
        sys.settrace(self._trace)
        with event.install_listener("numba:compile", compiling):
            yield
        sys.settrace(None)
        seconds = time.process_time() - start - compiling.seconds
        if self.passed and seconds <= self.longest:
            functions = sorted(self.called | self.shared)
            row = {"id": item.nodeid, "seconds": round(seconds, 3), "functions": functions}
            with self.rows.open("a", encoding="utf-8") as file:
                file.write(json.dumps(row) + "\n")

    @pytest.hookimpl(hookwrapper=True)
    def pytest_runtest_setup(self, item: Any) -> Iterator[None]:
        # What fixtures of a module call counts for all of its tests.
        yield
        self.shared |= self.called

    @pytest.hookimpl(hookwrapper=True)
    def pytest_runtest_call(self, item: Any) -> Iterator[None]:
        if self.stop:
            signal.signal(signal.SIGPROF, _too_long)
            signal.setitimer(signal.ITIMER_PROF, self.longest)
        yield
        signal.setitimer(signal.ITIMER_PROF, 0.0)

    def pytest_runtest_logreport(self, report: Any) -> None:
        self.passed &= report.passed


class _Compiling(event.Listener):
    """Seconds of the processor that numba compiles for."""

    def __init__(self):
        self.seconds = 0.0
        self.depth = 0
        self.start = 0.0

    def on_start(self, event: Any) -> None:
        self.start = self.start if self.depth else time.process_time()
        self.depth += 1

    def on_end(self, event: Any) -> None:
        self.depth -= 1
        self.seconds += 0.0 if self.depth else time.process_time() - self.start


def _too_long(number: int, frame: Any) -> None:
    raise _TooLong


class _Watcher:
    """Plugin of pytest: writes which test failed."""

    def __init__(self, said: Path):
        self.said = said

    def pytest_runtest_logreport(self, report: Any) -> None:
        if report.failed:
            self.said.write_text(report.nodeid, encoding="utf-8")


def _pytest(root: Path, arguments: list[str], plugins: list[Any]) -> int:
    fixed = ["-p", "no:cacheprovider", f"--rootdir={root}", "-m", LEFT_OUT, "-p", "no:xdist"]
    return pytest.main([*arguments, "-q", "--tb=line", *fixed], plugins)


def dotted(file: str) -> str:
    """The module of a file of a room."""
    return "surefoot." + file.removesuffix(".py").replace("/", ".").removesuffix(".__init__")


@cache
def _imports_of_tests(root: Path, folders: tuple[str, ...]) -> dict[Path, frozenset[str]]:
    """Test file -> modules that it imports in turn."""
    paths = [path for folder in folders for path in sorted((root / folder).rglob("test_*.py"))]
    return {
        path: frozenset(imported_sources("surefoot.tests." + path.stem, str(path)))
        for path in paths
    }


@cache
def _modules(root: Path) -> dict[str, Path]:
    """Module -> its source."""
    paths = (path for room in ROOMS for path in sorted((root / room).rglob("*.py")))
    return {dotted(path.relative_to(root).as_posix()): path for path in paths}


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
    return {
        name: frozenset(imported_sources(name))
        for name, path in _modules(root).items()
        if f"from {KERNELS} import" in path.read_text(encoding="utf-8")
    }
