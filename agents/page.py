"""The page: a body in the browser, to be cut by hand, watched, and played back.

It is served to this machine alone unless another host is named, and then pages of other sites cannot reach it through the
browser either. Whoever reaches it can cut and write recordings.
"""

import contextlib
import errno
import io
import pathlib
import re
import socket
import threading
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

from agents.choice import DEFAULT_SCENE, home_of
from agents.interruption import Interruption
from agents.recording import Recording, read_recording
from agents.scripted import POLICIES
from agents.session import Session, place_of_seed
from envs.resect import ResectEnv
from gmapspring.errors import ConfigError, GmapspringError

LOOPBACK = ("127.0.0.1", "localhost", "::1")
"""This machine's addresses of its own."""
HOST, PORT = "127.0.0.1", 8080
"""Where the page is served unless told otherwise: to this machine alone."""
SPLIT = "train"
"""Scenes that are played unless told otherwise: those that may be recorded to learn from."""
POLICY = "lookahead"
"""Who gives hints unless told otherwise."""
THINKING = ("shield:rim-first", "foresight:300:rim-first", "search:300")
"""Policies that can be asked besides the scripted ones."""
RECORDINGS = pathlib.Path("runs/recordings")
"""Where recordings are written unless told otherwise."""


class PageError(GmapspringError, RuntimeError):
    """A page that cannot be served."""


@dataclass(frozen=True)
class ViewOptions:
    """What to show, and where; None leaves the choice to the recording or the policy, or else to the defaults above."""

    scene: str | None = None
    """A shipped scene or a scene file."""
    split: str | None = None
    """train, validation or test."""
    scene_seed: int | None = None
    """Seed of the first scene."""
    index: int | None = None
    """Number of the first scene in its split, in place of its seed."""
    mask: str | None = None
    """What counts as legal, a name of `envs.actions.MASKS`."""
    policy: str | None = None
    """Who gives hints, any name that `agents.choice` knows."""
    play: pathlib.Path | None = None
    """A recording to be shown."""
    recordings: pathlib.Path = RECORDINGS
    """Folder to save recordings in."""
    host: str = HOST
    port: int = PORT
    """0 for any that is free."""
    seed: int = 0
    """Of what is random in policies."""


def serve(options: ViewOptions, stop: threading.Event | None = None) -> int:
    """Serve the page until Ctrl-C, or until `stop` is set; return the exit code.

    Raises:
        ConfigError: viser is missing, or there is no such scene, split, mask or policy.
        RecordingError: the recording cannot be read, or is of another scene.
        CheckpointError: the policy's file is not a usable one.
        PageError: the page cannot be served at that host and port.
    """
    try:
        import viser  # noqa: F401
    except ImportError as error:
        raise ConfigError(f"the page needs {error.name}: pip install 'gmapspring[viewer]'") from None
    from agents.page_loop import Page

    stop = stop or threading.Event()
    check_address(options.host, options.port)
    session = open_session(options)
    with Interruption() as interruption, _serving(options) as server:
        page = Page(server, session, policies_of(session), options.recordings)
        host = f"[{options.host}]" if ":" in options.host else options.host
        print(f"the page is http://{host}:{server.get_port()}; Ctrl-C ends it", flush=True)
        page.run(lambda: stop.is_set() or interruption.signal is not None)
    return 0


@contextlib.contextmanager
def _serving(options: ViewOptions) -> Iterator[Any]:
    """Run a server without pages of its own, and without its chatter."""
    import viser

    with contextlib.redirect_stdout(io.StringIO()), _same_origin(options.host):
        server = viser.ViserServer(options.host, options.port, label="gmapspring", verbose=False)
    # Any browser may ask for a public address: nobody gets one.
    server.request_share_url = lambda verbose=True: None  # type: ignore[method-assign]
    try:
        if options.port not in (0, server.get_port()):
            # viser goes on to the next port where another program was faster than it.
            raise PageError(in_use(options.host, options.port))
        yield server
    finally:
        with contextlib.redirect_stdout(io.StringIO()):
            server.stop()


@contextlib.contextmanager
def _same_origin(host: str) -> Iterator[None]:
    """Let servers that start meanwhile, if at this machine's own address, refuse what pages of other sites ask for."""
    from websockets.asyncio import server as sockets

    serve = sockets.serve
    if host in LOOPBACK:
        local = re.compile(r"https?://(localhost|127\.0\.0\.1|\[::1\])(:\d+)?")
        sockets.serve = partial(serve, origins=[None, local])  # type: ignore[assignment, misc]
    try:
        yield
    finally:
        sockets.serve = serve  # type: ignore[misc]


def open_session(options: ViewOptions) -> Session:
    """Return the session that is asked for."""
    if options.scene_seed is not None and options.index is not None:
        raise ConfigError("both a scene seed and an index choose a scene; give one of them")
    recording = read_recording(options.play) if options.play else None
    try:
        env = ResectEnv(*_setting(options, recording))
    except ConfigError as error:
        if recording is None or options.scene:
            raise
        raise ConfigError(f"{error}; {options.play} shows {recording.title}: name the file of that scene by --scene") from None
    split = options.split or (recording.split if recording else SPLIT)
    session = Session(env, split, options.policy or POLICY, options.seed)
    if recording is not None:
        session.play(recording, str(options.play))
    elif options.scene_seed is not None:
        session.begin(place_of_seed(env, options.scene_seed))
    elif options.index is not None:
        session.begin(options.index)
    return session


def _setting(options: ViewOptions, recording: Recording | None) -> tuple[str, str, str]:
    """Return scene, split and mask: what is asked for, or else what the recording or the policy is at home with."""
    if recording is not None:
        home = recording.scene, recording.split, recording.mask
    elif options.policy:
        scene, mask = home_of(options.policy)
        home = scene, SPLIT, mask
    else:
        home = DEFAULT_SCENE, SPLIT, "all"
    return options.scene or home[0], options.split or home[1], options.mask or home[2]


def policies_of(session: Session) -> list[str]:
    """Return who can be asked for hints: the session's own policy, and all that need no file."""
    return list(dict.fromkeys([session.policy_name, *POLICIES, *THINKING]))


def check_address(host: str, port: int) -> None:
    """Raise where nothing can be served at a host and port."""
    if not 0 <= port < 2**16:
        raise PageError(f"there is no port {port}; give one from 1 to 65535, or 0 for any that is free")
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, kind, protocol) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind(address)
    except OSError as error:
        if error.errno == errno.EADDRINUSE:
            raise PageError(in_use(host, port)) from None
        raise PageError(f"cannot serve at {host}, port {port}: {error.strerror or error}; choose others") from None


def in_use(host: str, port: int) -> str:
    """Return that a port is taken, and the way out."""
    return f"port {port} of {host} is in use; end what uses it, or choose another, or 0 for any that is free"
