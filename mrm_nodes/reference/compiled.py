"""How a formula becomes machine code, and how arrays are handed to it.

Three things live here: `formula`, the decorator of every scalar equation; `Kernel`, a loop over arrays that
is compiled on its first call and kept in numba's cache, by one process for all; and `run`, which flattens
broadcast arrays without copying them, cuts the work into ranges and spreads the ranges over threads.

Compiling takes a minute where nothing is kept yet: `mrm_nodes.compiling` says how long it took."""

import fcntl
import hashlib
import math
import os
import re
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, nullcontext, suppress
from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import numba
import numpy as np
from llvmlite import ir  # type: ignore[import-untyped]
from numba import config, types
from numba.core import event
from numba.core.caching import FunctionCache
from numba.core.ccallback import CFunc
from numba.extending import intrinsic
from numpy.typing import NDArray

from mrm_nodes import cachefolder, compiling

Array = NDArray[np.float64]

_CONFIGURED = int(vars(config)["NUMBA_NUM_THREADS"])

# Division follows IEEE 754: numba's default would put a branch before each one, and no loop would vectorise.
formula = numba.njit(error_model="numpy")

# A product and a sum may be one instruction: only for functions of which v and l are given the same, because
# such an instruction rounds its two products differently and reciprocity would hold to 1e-11 only.
contracted = numba.njit(error_model="numpy", fastmath={"contract"}, forceinline=True)

# For what is given the place of a row, or is too long for LLVM to inline by itself: a loop vectorises only over what it
# has within.
inlined = numba.njit(error_model="numpy", forceinline=True)


def named(*bundles: str) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """For a formula that is made of others: its name says of which, so that no two have one name.

    What numba compiles it calls by its function's name, and of two of one name only one would be linked.
    """

    def rename(function: Callable[..., Any]) -> Callable[..., Any]:
        function.__qualname__ = function.__name__ = "_".join(
            [function.__name__, *(re.sub(r"\W+", "_", bundle) for bundle in bundles)]
        )
        return function

    return rename


def _prefetch(_: Any, array: Any, index: Any) -> Any:
    """Ask for the part of memory that holds `array[index]`.

    A kernel works on one block for long enough that the processor stops looking ahead. Nothing is read: the
    index may lie past the end.
    """

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        data = context.make_array(signature.args[0])(context, builder, arguments[0]).data
        number, pointer = ir.IntType(32), ir.IntType(8).as_pointer()
        function = builder.module.declare_intrinsic(
            "llvm.prefetch", [pointer], ir.FunctionType(ir.VoidType(), [pointer, number, number, number])
        )
        place = builder.bitcast(builder.gep(data, [arguments[1]]), pointer)
        read, everywhere, data_cache = number(0), number(3), number(1)
        builder.call(function, [place, read, everywhere, data_cache])
        return context.get_dummy_value()

    return types.none(array, index), generate


prefetch: Any = intrinsic(_prefetch)


def _call(_: Any, address: Any, array: Any) -> Any:
    """Call the machine code at an address with where an array begins."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        data = context.make_array(signature.args[1])(context, builder, arguments[1]).data
        function = ir.FunctionType(ir.VoidType(), [data.type])
        builder.call(builder.inttoptr(arguments[0], function.as_pointer()), [data])
        return context.get_dummy_value()

    return types.none(address, array), generate


_call_address: Any = intrinsic(_call)


@formula
def call(address: int, scratch: Array) -> None:
    """Run the `KernelPart` at an address on a block."""
    if address == 0:
        raise NotImplementedError("a part that was not asked for")
    _call_address(address, scratch)


INPUT = types.Array(types.float64, 2, "A", readonly=True)
DENSE = types.Array(types.float64, 1, "C", readonly=True)
OUTPUT = types.Array(types.float64, 1, "C")
MODES = types.Array(types.int64, 1, "C")

# Ranges handed to a thread: long enough to hide Python, short enough to balance the load.
RANGE = 1 << 15
# Elements copied at a time where an input cannot be viewed as (n, components).
CHUNK = 1 << 18


@lru_cache(maxsize=1)
def _source_stamp() -> str:
    """A digest of the sources that are compiled.

    Numba only watches the file that a kernel is written in; the formulas are in the others.
    """
    digest = hashlib.sha256(numba.__version__.encode())
    for path in sorted(Path(__file__).parent.glob("*.py")):
        source = path.read_bytes()
        if any(
            mark in source for mark in (b"@formula", b"@contracted", b"@inlined", b"Kernel(", b"KernelPart(")
        ):
            digest.update(source)
    return digest.hexdigest()


class _Clock(event.Listener):
    """Tells when numba compiles: anything, ufuncs and formulas that are called from Python too."""

    def on_start(self, _: Any) -> None:
        compiling.begin()

    def on_end(self, _: Any) -> None:
        compiling.end()


event.register("numba:compiler_lock", _Clock())  # type: ignore[no-untyped-call]


class _StampedCache(FunctionCache):
    """Numba's, by our sources. What is damaged in it is compiled again; what cannot be kept is used all the same."""

    def _index_key(self, sig: Any, codegen: Any) -> Any:
        return (*super()._index_key(sig, codegen), _source_stamp())  # type: ignore[no-untyped-call]

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        try:
            return super().load_overload(sig, target_context)  # type: ignore[no-untyped-call]
        except Exception:  # a damaged file can be anything
            with suppress(OSError):
                self.flush()  # type: ignore[no-untyped-call]
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        with suppress(OSError):
            super().save_overload(sig, data)  # type: ignore[no-untyped-call]

    def holds(self, sig: Any, target_context: Any) -> bool:
        """Whether there is machine code for a signature, without a look at it."""
        file: Any = self._cache_file
        target_context.refresh()
        try:
            name = file._load_index().get(self._index_key(sig, target_context.codegen()))
            return name is not None and Path(file._data_path(name)).is_file()
        except Exception:  # a damaged file can be anything
            return False

    @property
    def folder(self) -> Path:
        """Where it keeps what it is given."""
        return Path(self.cache_path)

    @contextmanager
    def alone(self, wait: bool) -> Iterator[bool]:
        """Keep other processes from compiling the same for as long as the block lasts.

        False where one does already, and `wait` is false.
        """
        file: int | None = None
        try:
            try:
                path = Path(self.cache_path) / f"{self._impl.filename_base}.lock"
                file = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
                # Locks end with their process.
                fcntl.flock(file, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
            except BlockingIOError:
                yield False
                return
            except OSError:  # a file system without locks costs time, no more
                pass
            yield True
        finally:
            if file is not None:
                os.close(file)


class _PartCache(_StampedCache):
    """Of a function that is made of others, which its name tells from its like: numba's own key is of what they are
    at in this process."""

    def _index_key(self, sig: Any, codegen: Any) -> Any:
        return sig, codegen.magic_tuple(), _source_stamp()


class _Compiled:
    """A function that is compiled for one signature when it is asked for, once for all threads and processes."""

    _cache_of: type[_StampedCache] = _StampedCache

    def __init__(self, function: Callable[..., Any], signature: Any) -> None:
        self._function = function
        self._signature = signature
        self._compiled: Any = None
        self._lock = threading.Lock()

    @property
    def name(self) -> str:
        """What it is called where it is announced."""
        module = self._function.__module__.rpartition(".")[2]
        return f"{module}.{self._function.__name__.lstrip('_')}"

    def _uncompiled(self) -> tuple[Any, Any]:
        """What numba compiles, and for what target."""
        raise NotImplementedError

    def _compile(self, uncompiled: Any) -> Any:
        """What a call needs."""
        raise NotImplementedError

    def _dispatcher(self) -> tuple[Any, Any, Any]:
        """What numba compiles, for what target, and the cache of its machine code where there can be one."""
        uncompiled, context = self._uncompiled()
        if not cachefolder.choose_numbas():
            return uncompiled, context, None
        make: Any = self._cache_of
        uncompiled._cache = make(self._function)
        return uncompiled, context, uncompiled._cache

    def folder(self) -> Path | None:
        """Where its machine code is kept; None where that can be nowhere."""
        cache = self._dispatcher()[2]
        return None if cache is None else cache.folder

    def is_kept(self) -> bool:
        """Whether it was compiled before, by this process or another of the same machine."""
        if self._compiled is not None:
            return True
        _, context, cache = self._dispatcher()
        return cache is not None and cache.holds(self._signature, context)

    def compile(self) -> Any:
        """What a call needs, once for all threads; while another process compiles it, wait for that one."""
        self.prepare()
        return self._compiled

    def prepare(self, wait: bool = True) -> bool:
        """Have it compiled. False where another process is about it, and `wait` is false."""
        if self._compiled is not None:
            return True
        with self._lock:
            if self._compiled is not None:
                return True
            compiling.begin()
            try:
                uncompiled, _, cache = self._dispatcher()
                with nullcontext(True) if cache is None else cache.alone(wait) as mine:
                    if not mine:
                        return False
                    compiled = self._compile(uncompiled)
            finally:
                compiling.end()
            self._compiled = compiled
            return True


KERNELS: list[_Compiled] = []
"""What is compiled ahead: each loop that was made, and each part that is named for it, in the order of their making."""


class Kernel(_Compiled):
    """A function of (start, stop, inputs, dense, modes, outputs), compiled for one signature on its first
    call.

    `inputs` is a tuple of two-dimensional arrays; one signature serves every shape, because they are typed
    as arrays of any stride. `dense` holds the first two inputs again, as flat arrays, where memory has them
    in one piece; else it holds empty ones. `outputs` are flat."""

    def __init__(self, function: Callable[..., int], inputs: int, outputs: int) -> None:
        tuple_of: Any = types.UniTuple
        super().__init__(
            function,
            types.int64(
                types.int64,
                types.int64,
                tuple_of(INPUT, inputs),
                tuple_of(DENSE, 2),
                MODES,
                tuple_of(OUTPUT, outputs),
            ),
        )
        KERNELS.append(self)

    def _uncompiled(self) -> tuple[Any, Any]:
        dispatcher: Any = numba.njit(error_model="numpy", nogil=True)(self._function)
        return dispatcher, dispatcher.targetctx

    def _compile(self, uncompiled: Any) -> Any:
        uncompiled.compile(self._signature)
        uncompiled.disable_compile()
        return uncompiled


class KernelPart(_Compiled):
    """A function of a block's scratch memory that is made of formulas, which its name says; kernels `call` it by its
    address."""

    _cache_of = _PartCache

    def __init__(self, function: Callable[[Any], None]) -> None:
        pointer_to: Any = types.CPointer
        super().__init__(function, types.void(pointer_to(types.float64)))

    def _uncompiled(self) -> tuple[Any, Any]:
        make: Any = CFunc
        uncompiled = make(
            self._function, (self._signature.args, self._signature.return_type), {}, {"error_model": "numpy"}
        )
        return uncompiled, uncompiled._targetdescr.target_context

    def _compile(self, uncompiled: Any) -> Any:
        uncompiled.compile()
        return uncompiled

    @property
    def address(self) -> int:
        """Of its machine code, which is there for as long as the process."""
        return int(self.compile().address)


@lru_cache(maxsize=1)
def _pool(process: int) -> ThreadPoolExecutor:
    # The process id is the key: threads do not survive a fork.
    return ThreadPoolExecutor(max_workers=_CONFIGURED, thread_name_prefix="mrm-reference")


_threads: int | None = None


def thread_count() -> int:
    """Threads that a call may use: `NUMBA_NUM_THREADS` or the cores of the machine, unless
    `set_thread_count` says less.
    """
    return _CONFIGURED if _threads is None else _threads


def set_thread_count(count: int | None) -> None:
    """Limit the threads of later calls; None goes back to `NUMBA_NUM_THREADS`."""
    global _threads
    _threads = count


def _launch(kernel: Kernel, count: int, inputs: Any, modes: Any, outputs: Any) -> int:
    dense = tuple(_in_one_piece(array) for array in inputs[:2])
    work = kernel.compile()
    threads = thread_count()
    if count <= RANGE or threads == 1:
        return int(work(0, count, inputs, dense, modes, outputs))
    # One iterator for all: a thread that is held up takes fewer ranges.
    starts = iter(range(0, count, RANGE))

    def take(_: int) -> int:
        return sum(work(start, min(start + RANGE, count), inputs, dense, modes, outputs) for start in starts)

    return sum(_pool(os.getpid()).map(take, range(threads)))


def _in_one_piece(array: Array) -> Array:
    piece = array.reshape(-1) if array.flags.c_contiguous else np.empty(0)
    piece.flags.writeable = False
    return piece


def _collapsible(array: Array) -> bool:
    """Whether all axes but the last can be viewed as one."""
    axes = [
        (size, stride) for size, stride in zip(array.shape[:-1], array.strides[:-1], strict=True) if size > 1
    ]
    return all(a[1] == b[0] * b[1] for a, b in pairwise(axes))


def _flatten(array: Array) -> Array:
    if array.ndim == 2:
        return array
    return array.reshape(-1, array.shape[-1])


def run(
    kernel: Kernel,
    inputs: Sequence[Array],
    modes: Sequence[int],
    components: Sequence[int],
    tables: Sequence[Array] = (),
) -> tuple[list[Array], int]:
    """Run a kernel over arrays whose leading axes broadcast together.

    Every input has shape `(..., c)`, c its own number of components; the outputs have the broadcast leading
    shape and the given numbers of components. Inputs are not copied unless broadcasting makes a view
    impossible, and then a chunk at a time. `tables` follow the inputs as they are. The second result is the
    sum of what the kernel returned."""
    shape = np.broadcast_shapes(*(array.shape[:-1] for array in inputs))
    outputs = [np.empty((*shape, c)) for c in components]
    flags = np.asarray(modes, dtype=np.int64)
    if math.prod(shape) == 0:
        return outputs, 0
    views = [np.broadcast_to(array, (*shape, array.shape[-1])) for array in inputs]
    return outputs, _run_views(kernel, views, flags, outputs, tuple(tables))


def _run_views(
    kernel: Kernel, views: list[Array], modes: Any, outputs: list[Array], tables: tuple[Array, ...]
) -> int:
    shape = outputs[0].shape[:-1]
    count = math.prod(shape)
    if count > CHUNK and not all(_collapsible(view) for view in views):
        step = max(1, CHUNK * shape[0] // count)
        return sum(
            _run_views(
                kernel, [v[k : k + step] for v in views], modes, [o[k : k + step] for o in outputs], tables
            )
            if step > 1 or len(shape) == 1
            else _run_views(kernel, [v[k] for v in views], modes, [o[k] for o in outputs], tables)
            for k in range(0, shape[0], step)
        )
    flat = tuple(_flatten(view) for view in views) + tables
    out = tuple(output.reshape(-1) for output in outputs)
    return _launch(kernel, count, flat, modes, out)
