"""OpenGL without a screen: one context per process and backend, and a probe that says what works here."""

from __future__ import annotations

import atexit
import contextlib
import contextvars
import ctypes
import ctypes.util
import difflib
import json
import os
import queue
import struct
import subprocess
import sys
import threading
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import asdict, dataclass
from typing import Any, TypeVar

import moderngl

from mrm_nodes.errors import MrmError

#: The backends, in the order in which `auto` tries them.
BACKENDS = ("egl", "osmesa")

#: MaterialX generates `#version 400`.
MINIMUM_VERSION = 400

#: What to install where a backend is missing.
HINTS = {
    "egl": "install EGL and Mesa's drivers (Debian, Ubuntu: apt-get install libegl1 libgl1-mesa-dri)",
    "osmesa": "install OSMesa (Debian 12: apt-get install libosmesa6; Mesa 25.1 and later no longer have it)",
}

_PROBE_TIMEOUT_SECONDS = 60.0

#: How long one draw may take, and how long a process that ends waits for the last one.
_DRAW_SECONDS, _LAST_SECONDS = 1800.0, 5.0

_GL_SYNC_GPU_COMMANDS_COMPLETE, _GL_SYNC_FLUSH_COMMANDS_BIT, _GL_TIMEOUT_EXPIRED = 0x9117, 1, 0x911B

T = TypeVar("T")


class GLContext:
    """A headless OpenGL context on a thread of its own: OpenGL is called there and nowhere else.

    A driver lets a context belong to one thread at a time. moderngl keeps Python's lock while it calls the driver,
    and a software driver uses every core for one draw, so that a context for each thread would gain nothing.

    Args:
        backend: `egl` or `osmesa`.

    Attributes:
        ctx: moderngl's view of it, for what `run` does; its `info` and limits may be read anywhere.
        load: the loader of its functions.

    Raises:
        Exception: whatever the layers below have to say.
    """

    def __init__(self, backend: str) -> None:
        self.backend = backend
        self._process = os.getpid()
        self._jobs: queue.SimpleQueue[Callable[[], object] | None] = queue.SimpleQueue()
        self._ended = ""
        self._thread = threading.Thread(
            target=_work, args=(self._jobs,), name=f"OpenGL {backend}", daemon=True
        )
        self._thread.start()
        atexit.register(self._end)
        try:
            self.ctx, self.load = self.run(lambda: _create(backend))
        except BaseException:
            self._end()
            raise

    def run(self, work: Callable[[], T]) -> T:
        """Do something with OpenGL on the context's thread, after what others have asked for, and wait for it.

        Raises:
            MrmError: this process is a fork of the context's, or is ending, or a former draw has never ended.
        """
        if os.getpid() != self._process:
            raise MrmError(
                "OpenGL does not outlive a fork, and the process that this one was forked from has used it; "
                'start processes that render with multiprocessing.get_context("spawn")'
            )
        if threading.get_ident() == self._thread.ident:
            return work()
        done: Future[T] = Future()
        surroundings = contextvars.copy_context()

        def job() -> None:
            try:
                if self._ended:
                    raise MrmError(self._ended)
                done.set_result(surroundings.run(work))
            except BaseException as error:  # the one who waits has it
                done.set_exception(error)

        if self._ended:
            raise MrmError(self._ended)

        self._jobs.put(job)
        return done.result()

    def post(self, work: Callable[[], object]) -> None:
        """Have something done on the context's thread, some time: finalisers may call this, on any thread.

        In another process than the context's, or where that is ending, nothing is left to do.
        """
        if os.getpid() == self._process and not self._ended:
            self._jobs.put(work)

    def _end(self) -> None:
        if os.getpid() == self._process:
            self._ended = self._ended or "this process is ending: it renders nothing more"
            self._jobs.put(None)
            self._thread.join(_LAST_SECONDS)

    def wait(self) -> None:
        """Wait until everything is drawn; threads that do not need OpenGL go on meanwhile.

        Raises:
            MrmError: that takes longer than `MRM_DRAW_SECONDS`, or half an hour. The driver may be at it for ever,
                so that this context draws nothing more.
        """
        seconds = float(os.environ.get("MRM_DRAW_SECONDS") or _DRAW_SECONDS)
        fence = self._function("glFenceSync", ctypes.c_void_p, ctypes.c_uint, ctypes.c_uint)(
            _GL_SYNC_GPU_COMMANDS_COMPLETE, 0
        )
        client_wait = self._function(
            "glClientWaitSync", ctypes.c_uint, ctypes.c_void_p, ctypes.c_uint, ctypes.c_uint64
        )
        if client_wait(fence, _GL_SYNC_FLUSH_COMMANDS_BIT, int(seconds * 1e9)) == _GL_TIMEOUT_EXPIRED:
            self._ended = (
                f"the driver has not finished a draw within {seconds:g} s: a loop in the shader may never end; "
                "this process renders nothing more (MRM_DRAW_SECONDS sets the limit)"
            )
            _leave_without_farewell()
            raise MrmError(self._ended)
        self._function("glDeleteSync", None, ctypes.c_void_p)(fence)

    def call(self, function: str, *arguments: Any) -> None:
        """Call a GL function that moderngl does not wrap, with integers and ctypes arrays."""
        types = [ctypes.c_void_p if isinstance(a, ctypes.Array) else ctypes.c_int for a in arguments]
        self._function(function, None, *types)(*arguments)

    def _function(self, name: str, result: Any, *arguments: Any) -> Callable[..., Any]:
        return ctypes.CFUNCTYPE(result, *arguments)(self.load(name))

    @property
    def upload_unit(self) -> int:
        """The texture unit for making and changing textures: moderngl's own, which no draw reads."""
        return int(self.ctx.max_texture_units) - 1

    def bind(self, textures: Mapping[str, moderngl.Texture], samplers: Mapping[str, Any]) -> None:
        """Bind what a program's samplers read, just before its draw: nothing that came before decides it.

        One texture takes one unit, however many samplers read it; there are `upload_unit` of them.

        Args:
            textures: by the name of the sampler.
            samplers: their `moderngl.Uniform`s.
        """
        units: dict[int, int] = {}
        for name, texture in textures.items():
            unit = units.setdefault(texture.glo, len(units))
            texture.use(unit)
            samplers[name].value = unit

    @property
    def renderer(self) -> str:
        """Name of the GPU or of the software driver."""
        return str(self.ctx.info["GL_RENDERER"])


def _leave_without_farewell() -> None:
    """Have this process end without the driver's last rites: OSMesa's wait for every draw."""
    with contextlib.suppress(AttributeError):  # the GNU C library has it, with the status as first argument
        library = ctypes.CDLL(None)
        library.on_exit(ctypes.cast(library._exit, ctypes.c_void_p), None)


def _work(jobs: queue.SimpleQueue[Callable[[], object] | None]) -> None:
    """What a context's thread does: a job at a time, until there is None."""
    for job in iter(jobs.get, None):
        # Nobody waits for what was posted; the others keep what they raise.
        with contextlib.suppress(Exception):
            job()
        del job  # what it holds is not kept until the next one comes


@dataclass(frozen=True)
class BackendReport:
    """What a probe found out about one backend; `reason` and `hint` are empty where it works."""

    backend: str
    """`egl` or `osmesa`."""
    works: bool
    """Whether OpenGL 4.0 is there."""
    vendor: str = ""
    """What OpenGL says of itself."""
    renderer: str = ""
    """Likewise: the driver or the card."""
    version: str = ""
    """Likewise."""
    reason: str = ""
    """Why it does not work."""
    hint: str = ""
    """What to install."""


class _OSMesaContext:
    """An OSMesa context with the four methods that `moderngl.create_context(context=...)` asks for."""

    # GL/osmesa.h
    _FORMAT, _RGBA, _DEPTH_BITS, _PROFILE, _CORE_PROFILE = 0x22, 0x1908, 0x30, 0x33, 0x34
    _MAJOR_VERSION, _MINOR_VERSION, _UNSIGNED_BYTE = 0x36, 0x37, 0x1401

    def __init__(self) -> None:
        library = _load_osmesa()
        library.OSMesaCreateContextAttribs.restype = ctypes.c_void_p
        library.OSMesaCreateContextAttribs.argtypes = [ctypes.POINTER(ctypes.c_int), ctypes.c_void_p]
        library.OSMesaMakeCurrent.restype = ctypes.c_ubyte
        library.OSMesaMakeCurrent.argtypes = [
            ctypes.c_void_p,
            ctypes.c_void_p,
            ctypes.c_uint,
            ctypes.c_int,
            ctypes.c_int,
        ]
        library.OSMesaDestroyContext.restype = None
        library.OSMesaDestroyContext.argtypes = [ctypes.c_void_p]
        library.OSMesaGetProcAddress.restype = ctypes.c_void_p
        library.OSMesaGetProcAddress.argtypes = [ctypes.c_char_p]
        self._library = library
        attributes = [self._FORMAT, self._RGBA, self._DEPTH_BITS, 24, self._PROFILE, self._CORE_PROFILE]
        attributes += [self._MAJOR_VERSION, 4, self._MINOR_VERSION, 0, 0, 0]
        self._context = library.OSMesaCreateContextAttribs(
            (ctypes.c_int * len(attributes))(*attributes), None
        )
        if not self._context:
            raise OSError("OSMesaCreateContextAttribs gave no OpenGL 4.0 core context")
        # OSMesa insists on a window's memory, although everything is drawn into framebuffer objects.
        self._window = (ctypes.c_ubyte * 4)()
        self.__enter__()

    def load(self, name: str) -> int:
        return self._library.OSMesaGetProcAddress(name.encode()) or 0

    def __enter__(self) -> None:
        if not self._library.OSMesaMakeCurrent(self._context, self._window, self._UNSIGNED_BYTE, 1, 1):
            raise OSError("OSMesaMakeCurrent failed")

    def __exit__(self, *exception: object) -> None:
        self._library.OSMesaMakeCurrent(None, None, self._UNSIGNED_BYTE, 0, 0)

    def release(self) -> None:
        self._library.OSMesaDestroyContext(self._context)


def _load_osmesa() -> ctypes.CDLL:
    names = ["libOSMesa.so.8", "libOSMesa.so.6", "libOSMesa.so", ctypes.util.find_library("OSMesa")]
    for name in names:
        if name is None:
            continue
        try:
            library = ctypes.CDLL(name)
        except OSError:
            continue
        if hasattr(library, "OSMesaCreateContextAttribs"):
            return library
    raise OSError("libOSMesa is not installed")


def _create_egl() -> Any:
    """Create a surfaceless context on the first EGL device that gives one: GPUs come before software."""
    import glcontext

    create = glcontext.get_backend_by_name("egl")
    # Devices that may not be opened are passed over; libEGL would write about each to stderr.
    os.environ.setdefault("EGL_LOG_LEVEL", "fatal")
    # libEGL finds every GL function by itself, so that libGL need not be installed.
    library = os.environ.get("GLCONTEXT_LINUX_LIBEGL", "libEGL.so.1")
    errors: list[str] = []
    for device in range(16):
        try:
            return create(
                mode="standalone",
                libgl=library,
                libegl=library,
                glversion=MINIMUM_VERSION,
                device_index=device,
            )
        except Exception as error:  # glcontext raises bare Exception
            if "device index" in str(error):
                break
            errors.append(str(error))
            if "loaded" in str(error):
                break
    raise OSError("; ".join(dict.fromkeys(errors)) or "EGL lists no device")


def _create(backend: str) -> tuple[moderngl.Context, Callable[[str], int]]:
    native: Any = _OSMesaContext() if backend == "osmesa" else _create_egl()
    ctx = moderngl.create_context(context=native, require=MINIMUM_VERSION)
    # Objects are released explicitly: a finaliser could run while another context is current.
    ctx.gc_mode = None  # type: ignore[assignment]
    # moderngl reads the limits when first asked, from whichever context is current then: ask now, while this one is.
    if not ctx.info["GL_MAX_TEXTURE_SIZE"]:
        raise OSError("the driver tells no limits")
    return ctx, native.load


_contexts: dict[str, GLContext | str] = {}
_creation = threading.Lock()


def _renew_lock() -> None:
    """In a forked child no thread is left that could open the lock."""
    global _creation
    _creation = threading.Lock()


os.register_at_fork(after_in_child=_renew_lock)


def _cached(backend: str) -> GLContext | str:
    """Return the context of one backend, or why there is none: a failure is not tried again."""
    with _creation:
        if backend not in _contexts:
            try:
                _contexts[backend] = GLContext(backend)
            except Exception as error:  # every layer below has exceptions of its own
                _contexts[backend] = " ".join(str(error).split()) or type(error).__name__
        return _contexts[backend]


def unknown_backend(name: str, known: Sequence[str]) -> str:
    """What to say of a backend that is none: the one that is like it, else all."""
    # Names as short as these are like others by chance: `glx` is not meant for `egl`.
    close = difflib.get_close_matches(name[:100], known, n=1, cutoff=0.75)
    hint = f"did you mean {close[0]}?" if close else f"known: {', '.join(known)}"
    return f"unknown backend {name}; {hint}"


def get_context(backend: str = "auto") -> GLContext:
    """Return this process's context of a backend, creating it on first use.

    Args:
        backend: `egl`, `osmesa`, or `auto` for the first of them that works.

    Raises:
        MrmError: an unknown backend, or no OpenGL 4.0 there; says what to install.
    """
    if backend not in (*BACKENDS, "auto"):
        raise MrmError(unknown_backend(backend, ("auto", *BACKENDS)))
    tried = BACKENDS if backend == "auto" else (backend,)
    reasons = []
    for name in tried:
        found = _cached(name)
        if isinstance(found, GLContext):
            return found
        reasons.append(f"{name}: {found}; {HINTS[name]}")
    raise MrmError("no OpenGL without a display: " + " | ".join(reasons))


def probe_backends(request: str = "all") -> list[BackendReport]:
    """Try the backends that a request hangs on, each in a process of its own: even a crashing driver does no harm.

    Never raises.

    Args:
        request: a backend; `all`; or `auto`, for which the second is tried only where the first does not work.
    """
    if request != "auto":
        wanted = BACKENDS if request == "all" else tuple(name for name in BACKENDS if name == request)
        with ThreadPoolExecutor(len(BACKENDS)) as pool:
            return list(pool.map(_probe, wanted))
    reports = []
    for backend in BACKENDS:
        reports.append(_probe(backend))
        if reports[-1].works:
            break
    return reports


def _probe(backend: str) -> BackendReport:
    # This file alone, without its package: a run waits for the probe.
    command = [sys.executable, "-P", __file__, backend]
    # The child must find this package wherever this process found it.
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}
    try:
        child = subprocess.run(
            command, capture_output=True, text=True, env=environment, timeout=_PROBE_TIMEOUT_SECONDS
        )
        if child.returncode == 0:
            return BackendReport(**json.loads(child.stdout.splitlines()[-1]))
        last_line = (child.stderr.strip().splitlines() or ["no message"])[-1]
        reason = f"the driver ended the probe with status {child.returncode}: {last_line}"
    except subprocess.TimeoutExpired:
        reason = f"the driver did not answer within {_PROBE_TIMEOUT_SECONDS:g} s"
    except Exception as error:  # the promise is never to raise
        reason = f"the probe could not run: {error}"
    return BackendReport(backend, False, reason=reason, hint=HINTS[backend])


def _probe_here(backend: str) -> None:
    """Print a BackendReport as JSON: create the context and draw one float32 pixel with it."""
    found = _cached(backend)
    if isinstance(found, str):
        report = BackendReport(backend, False, reason=found, hint=HINTS[backend])
    else:
        info = found.ctx.info
        works = found.run(lambda: _draws_one_pixel(found.ctx))
        report = BackendReport(
            backend,
            works,
            vendor=str(info["GL_VENDOR"]),
            renderer=str(info["GL_RENDERER"]),
            version=str(info["GL_VERSION"]),
            reason="" if works else "a float32 pixel does not come back as it was drawn",
            hint="" if works else HINTS[backend],
        )
    print(json.dumps(asdict(report)))


def _draws_one_pixel(ctx: moderngl.Context) -> bool:
    program = ctx.program(
        vertex_shader="#version 400\nvoid main() { gl_Position = vec4(0.0, 0.0, 0.0, 1.0); }",
        fragment_shader="#version 400\nout vec4 c; void main() { c = vec4(-1.5, 1e-6, 70000.0, 1.0); }",
    )
    target = ctx.framebuffer([ctx.texture((1, 1), 4, dtype="f4")])
    target.use()
    target.clear()
    ctx.vertex_array(program, []).render(moderngl.POINTS, vertices=1)
    pixel: bytes = target.read(components=4, dtype="f4")
    return pixel == struct.pack("4f", -1.5, 1e-6, 70000.0, 1.0)


if __name__ == "__main__":
    _probe_here(sys.argv[1])
