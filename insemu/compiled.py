"""Compiled kernels: for a named processor, kept on disk, and none older than the kernels that it calls.

All kernels are made for one baseline instead of the processor at hand (:func:`baseline`), so that answers are the same on each, and what one
machine has compiled serves another. A wheel brings them compiled (:data:`SHIPPED`); what it lacks is compiled once and kept in
:func:`own_folder`. numba renews a cached function when the file that defines it changes, but not when a function that was inlined into it
changes in another file: here a change of any file with kernels renews all of them.

numba makes a whole program of every kernel: optimized, in instructions, callable from Python and from C. One that another kernel calls is here
a part of it (:class:`_Part`): typed and lowered once, optimized and made into instructions with the kernel that Python calls.
"""

from __future__ import annotations

import gc
import hashlib
import json
import os
import platform
import re
import subprocess
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, nullcontext, suppress
from functools import cache, wraps
from importlib import import_module
from pathlib import Path
from typing import IO, Any, TypeVar

import numba
import portalocker
from numba.core import config, errors, sigutils
from numba.core.caching import CompileResultCacheImpl, FunctionCache, IndexDataCacheFile, _CacheLocator
from numba.core.ccallback import CFunc
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Flags, compile_extra
from numba.core.compiler_lock import global_compiler_lock
from numba.core.dispatcher import Dispatcher, _FunctionCompiler
from numba.core.registry import cpu_target
from numba.core.targetconfig import ConfigStack, TargetConfig
from numba.core.typing.templates import make_concrete_template
from numba.misc.appdirs import AppDirs
from numba.types import BaseFunction

from insemu.progress import say_once

_F = TypeVar("_F", bound=Callable[..., Any])

#: Folder of the package, and in it that of the kernels that come with a wheel; ``made.json`` says for which numba and processors.
PACKAGE = Path(__file__).resolve().parent
SHIPPED = PACKAGE / "kernels"
MADE = "made.json"
#: What a processor must have for code of the psABI level x86-64-v3 (Haswell, Zen and later).
V3 = ("avx", "avx2", "bmi", "bmi2", "f16c", "fma", "lzcnt", "movbe")


def baseline() -> str:
    """The processor, as LLVM names it, that kernels are compiled for: ``NUMBA_CPU_NAME``, or x86-64-v3 where this one is that, or generic."""
    given = os.environ.get("NUMBA_CPU_NAME")
    if given or platform.machine().lower() not in ("x86_64", "amd64"):
        return given or "generic"
    from llvmlite import binding

    features = binding.get_host_cpu_features()
    return "x86-64-v3" if all(features.get(name) for name in V3) else "generic"


#: While one of these kernels is compiled Python looks for garbage rarely: numba makes millions of objects that stay (a fifth of its time).
RARELY = (100_000, 20, 20)
_inside = False


@contextmanager
def _compiling() -> Iterator[None]:
    """Compile a kernel of :func:`njit`; numba compiles one at a time."""
    global _inside
    with global_compiler_lock:
        before, _inside, often = _inside, True, gc.get_threshold()
        gc.set_threshold(*RARELY)
        try:
            yield
        finally:
            _inside = before
            gc.set_threshold(*often)


class _Library(JITCodeLibrary):
    """Code of a part, which waits for the kernel that it is linked into."""

    def _optimize_final_module(self) -> None:
        """Leave that to the kernel, which optimizes all of its parts at once."""

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._finalized = True


class _Parts(_FunctionCompiler):
    """A function as parts of the kernels that call it, by the types of its arguments: without instructions, not callable from Python or C."""

    def __init__(self, kernel: Any) -> None:
        given = kernel.targetdescr, kernel.targetoptions, kernel.locals, kernel._compiler.pipeline_class
        super().__init__(kernel.py_func, *given)
        self.made: dict[tuple[Any, ...], Any] = {}

    def make(self, args: tuple[Any, ...]) -> None:
        """Have the part for these types."""
        if args not in self.made:
            try:
                self.made[args] = self.compile(args, None)
            except errors.ForceLiteralArg as e:
                raise e.bind_fold_arguments(lambda args, kws: self.fold_argument_types(args, kws)[1]) from None

    def _compile_core(self, args: Any, return_type: Any) -> Any:
        flags, typing, target = Flags(), self.targetdescr.typing_context, self.targetdescr.target_context
        self.targetdescr.options.parse_as_flags(flags, self.targetoptions)
        flags.no_cpython_wrapper = flags.no_cfunc_wrapper = flags.no_compile = True
        library = _Library(target.codegen(), self.py_func.__qualname__)
        given = typing, target, self.py_func, args, return_type, flags, self.locals
        made = compile_extra(*given, library=library, pipeline_class=self.pipeline_class)
        target.insert_user_function(library, made.fndesc, [library])
        return made


def _template(plain: Callable[..., Any]) -> Callable[..., Any]:
    """What the types of a call are: of a part where a kernel calls."""

    @wraps(plain)
    def get_call_template(self: Any, args: Any, kws: Any) -> Any:
        pysig, folded = self._compiler.fold_argument_types(args, kws)
        if not _inside or self.is_compiling or tuple(folded) in self.overloads:
            return plain(self, args, kws)
        if not hasattr(self, "_insemu_parts"):
            self._insemu_parts = _Parts(self)
        with self._compiling_counter:
            self._insemu_parts.make(tuple(folded))
        made = self._insemu_parts.made[tuple(folded)]
        return make_concrete_template("part", key=self.py_func.__name__, signatures=[made.signature]), pysig, folded, {}

    return get_call_template


def _overload(plain: Callable[..., Any]) -> Callable[..., Any]:
    """What is called: the part where a kernel calls and the function was not compiled by itself."""

    @wraps(plain)
    def get_overload(self: Any, sig: Any) -> Any:
        args = tuple(sigutils.normalize_signature(sig)[0])
        if args not in self.overloads and hasattr(self, "_insemu_parts"):
            return self._insemu_parts.made[args].library
        return plain(self, sig)

    return get_overload


def _remembered(plain: Callable[..., Any]) -> Callable[..., Any]:
    """Types of a call of a function of numba, which tries a dozen ways anew for each addition in a kernel."""
    found: dict[Any, Any] = {}

    @wraps(plain)
    def get_call_type(self: Any, context: Any, args: Any, kws: Any) -> Any:
        key = self, context, args, tuple(kws.items()), ConfigStack.top_or_none()
        if key not in found:
            found[key] = plain(self, context, args, kws)
        return found[key]

    return get_call_type


def _aim() -> None:
    """Make numba compile quickly, and for the baseline, unless a program has compiled with it before."""
    # numba hashes the values of all options whenever it looks a function up: a tenth of the time to compile. Equality still compares all values.
    TargetConfig.__hash__ = lambda self: hash(frozenset(self._values))
    BaseFunction.get_call_type = _remembered(BaseFunction.get_call_type)
    Dispatcher.get_call_template = _template(Dispatcher.get_call_template)
    Dispatcher.get_overload = _overload(Dispatcher.get_overload)
    if "_toplevel_target_context" not in vars(cpu_target):
        name = baseline()
        if os.environ.setdefault("NUMBA_CPU_NAME", name) == name:
            os.environ.setdefault("NUMBA_CPU_FEATURES", "")
        config.reload_config()


_aim()


def stamp_of(texts: Iterable[bytes]) -> str:
    """Hash of those sources, in a fixed order, that hold kernels or the tuples with names that kernels take."""
    found = hashlib.sha256()
    for text in texts:
        if re.search(
            rb"^\s*from (?:[\w.]+ import .*\b(?:njit|cfunc|intrinsic|NamedTuple)\b|numba\.extending import)",
            text,
            re.MULTILINE,
        ):
            found.update(hashlib.sha256(text).digest())
    return found.hexdigest()


@cache
def sources_stamp() -> str:
    """Hash of the contents of all files of the package that hold kernels."""
    return stamp_of(path.read_bytes() for path in sorted(PACKAGE.rglob("*.py")))


@cache
def _hash_of(file: str) -> str:
    with suppress(OSError):
        return hashlib.sha256(Path(file).read_bytes()).hexdigest()
    return ""  # typed into an interpreter: numba looks at the bytecode besides


@cache
def own_folder() -> Path:
    """Where kernels that were compiled here are kept: under ``NUMBA_CACHE_DIR``, else in the package, else among the user's caches."""
    given = os.environ.get("NUMBA_CACHE_DIR")
    if given:
        return Path(given) / "insemu"
    inside = PACKAGE / "__pycache__"
    if os.access(inside if inside.exists() else PACKAGE, os.W_OK):
        return inside
    return Path(AppDirs("insemu", appauthor=False).user_cache_dir)


def writable() -> bool:
    """Whether what is compiled here can be kept."""
    with suppress(OSError):
        own_folder().mkdir(parents=True, exist_ok=True)
    return own_folder().is_dir() and os.access(own_folder(), os.W_OK)


class _Locator(_CacheLocator):
    """Where numba keeps a kernel, and what tells whether it is still that of the sources."""

    def __init__(self, function: Callable[..., Any]) -> None:
        # a wavelet variance of a process is compiled by another module: its own file counts as well
        self._stamp = f"{sources_stamp()} {_hash_of(function.__code__.co_filename)}"
        self._line = function.__code__.co_firstlineno

    def ensure_cache_path(self) -> None:
        own_folder().mkdir(parents=True, exist_ok=True)

    def get_cache_path(self) -> str:
        return str(own_folder())

    def get_source_stamp(self) -> str:
        return self._stamp

    def get_disambiguator(self) -> str:
        return str(self._line)


class _Impl(CompileResultCacheImpl):
    """Kernels of all modules in one folder, by the module's whole name."""

    def __init__(self, function: Callable[..., Any]) -> None:
        self._locator = _Locator(function)
        self._lineno = function.__code__.co_firstlineno
        self._filename_base = self.get_filename_base(f"{function.__module__}.{function.__qualname__}", sys.abiflags)


def say_compiling() -> None:
    """Tell, once, that something is compiled."""
    say_once(f"Compiling kernels for {baseline()}: once, up to a minute (insemu --version says where they are kept)")


class _Files(IndexDataCacheFile):
    """The kernels of a function: those that came with the package, then those that were compiled here."""

    def __init__(self, folder: str, name: str, stamp: str) -> None:
        super().__init__(folder, name, stamp)
        self._shipped = IndexDataCacheFile(str(SHIPPED), name, stamp)

    def load(self, key: Any) -> Any:
        found = self._shipped.load(key)
        return super().load(key) if found is None else found


class _Kept(FunctionCache):
    """Cache of one kernel."""

    _impl_class = _Impl

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)
        self._cache_file = _Files(str(own_folder()), self._impl.filename_base, self._impl.locator.get_source_stamp())
        self._lock: IO[bytes] | None = None

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        found = self._read(sig, target_context)
        if found is None:
            say_compiling()
            self._hold()
            found = self._read(sig, target_context)  # what another process compiled meanwhile
        return found

    def _read(self, sig: Any, target_context: Any) -> Any:
        with suppress(OSError):
            return super().load_overload(sig, target_context)

    def _hold(self) -> None:
        """Wait until no other process compiles this kernel. A kernel waits for those that it calls, never they for it: no circle."""
        # where no folder can be written, or a file system cannot lock, each compiles for itself
        with suppress(OSError, portalocker.LockException):
            if self._lock is None:
                own_folder().mkdir(parents=True, exist_ok=True)
                self._lock = open(own_folder() / f"{self._impl.filename_base}.lock", "ab")
                portalocker.lock(self._lock, portalocker.LOCK_EX)

    @contextmanager
    def one_at_a_time(self) -> Iterator[None]:
        """Let other processes have the kernel afterwards, compiled or failed."""
        try:
            yield
        finally:
            if self._lock is not None:
                self._lock.close()
                self._lock = None

    def save_overload(self, sig: Any, data: Any) -> None:
        with suppress(OSError):  # no folder can be written, or the disk is full: the next process compiles again
            super().save_overload(sig, data)


def njit(*, cache: bool = False, **options: Any) -> Callable[[_F], _F]:
    """Numba's ``njit`` with the caching of this module.

    Parameters
    ----------
    cache : bool
        Whether compiled code is kept.
    **options
        Of numba.
    """

    def decorated(function: _F) -> _F:
        kernel: Any = numba.njit(**options)(function)
        if not hasattr(kernel, "compile"):  # with NUMBA_DISABLE_JIT it is the function itself
            return function
        kept_here, compile_ = _Kept(function) if cache else None, kernel.compile
        if kept_here is not None:
            kernel._cache = kept_here

        def compiled(sig: Any) -> Any:
            with kept_here.one_at_a_time() if kept_here else nullcontext(), _compiling():
                return compile_(sig)

        kernel.compile = compiled
        return kernel  # type: ignore[no-any-return]

    return decorated


def cfunc(signature: Any) -> Callable[[Callable[..., None]], Any]:
    """Numba's ``cfunc`` with the caching of this module; that of numba for functions outside the package."""

    def decorated(function: Callable[..., None]) -> Any:
        if not Path(function.__code__.co_filename).resolve().is_relative_to(PACKAGE):
            return numba.cfunc(signature, cache=True)(function)
        callback = CFunc(function, sigutils.normalize_signature(signature), locals={}, options={})
        callback._cache = _Kept(function)
        with callback._cache.one_at_a_time(), _compiling():
            callback.compile()
        return callback

    return decorated


def kept(kernel: str) -> bool:
    """Whether a kernel was compiled for this processor and its present sources.

    Parameters
    ----------
    kernel : str
        Module and function, for example ``insemu.filters.kernel.run``.
    """
    module, _, name = kernel.rpartition(".")
    files = getattr(import_module(module), name)._cache._cache_file
    target = cpu_target.target_context.codegen().magic_tuple()
    return any(key[1] == target for held in (files, files._shipped) for key in held._load_index())


def made_for() -> dict[str, str]:
    """What kernels of this process are valid for: Python, numba and sources."""
    python = ".".join(platform.python_version_tuple()[:2])
    return {"Python": python, "numba": numba.__version__, "sources": sources_stamp()}


def described() -> str:
    """Where the kernels come from, for ``insemu --version``."""
    target, here = baseline(), f"compiled here for {baseline()}, kept in {own_folder()}"
    try:
        made = json.loads((SHIPPED / MADE).read_text(encoding="utf-8"))
    except FileNotFoundError:
        return here
    other = [f"{what} {made[what]}" for what, now in made_for().items() if made[what] != now]
    if target not in made["processors"]:
        other.append(" and ".join(made["processors"]))
    return f"{here} (those that came with it are for {', '.join(other)})" if other else f"shipped for {target}"


_beside: subprocess.Popen[str] | None = None


@contextmanager
def compiled_beside(program: str, kernel: str) -> Iterator[None]:
    """Let another process compile kernels while this one does something else, where they have not been compiled yet.

    Parameters
    ----------
    program : str
        Module that calls them, for ``python -m``; it prints a line as soon as ``kernel`` is there and may go on to others.
    kernel : str
        Module and function, for example ``insemu.filters.kernel.run``: whether it is kept tells whether the program is needed.
    """
    global _beside
    if kept(kernel) or not writable():
        yield
        return
    say_compiling()
    package = PACKAGE.parent
    path = os.pathsep.join([str(package), *filter(None, [os.environ.get("PYTHONPATH")])])
    nothing = subprocess.DEVNULL
    with subprocess.Popen(
        [sys.executable, "-m", program],
        stdin=nothing,
        stdout=subprocess.PIPE,
        stderr=nothing,
        text=True,
        env=os.environ | {"PYTHONPATH": path},
    ) as _beside:
        try:
            yield
        finally:
            _beside.kill()
            _beside = None


def wait_for_kernels() -> None:
    """Wait until a process of :func:`compiled_beside` has the kernel that it was started for; where it failed, this one compiles it."""
    if _beside is not None and _beside.stdout is not None:
        _beside.stdout.readline()
