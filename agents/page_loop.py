"""The loop behind the page: what is asked for is done, one thing after the other, and what has changed is shown.

Browsers only put commands into a queue. One thread takes them out, so that no two things happen to a body at once.
"""

import itertools
import pathlib
import queue
import re
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import viser

from agents.page_colors import legend, paint_strain, paint_tissue
from agents.page_drawing import Drawing
from agents.page_panel import CUT_FACES, PEELS, REMOVE, WHOLE, Panel
from agents.page_readings import readings, status_of, title_of
from agents.picking import action_corners, cuttable_edges, face_cut, hit, removal, skin_of
from agents.recording import write_recording
from agents.session import Session
from gmapspring.errors import ConfigError, GmapspringError, TopologyError

FRAME = 0.05
"""Time between two pictures of a moving body [s]."""
IDLE = 0.25
"""How long the loop waits where nothing moves [s]."""
STEP = 0.005
"""What a step lets pass [s]."""
SEEN_THROUGH = 0.35
"""Opacity of the body while a hint is shown, which mostly lies inside."""
NO_FACES = np.zeros((0, 3), np.int64)


class Page:
    """One session, shown in all browsers that look at it."""

    def __init__(self, server: viser.ViserServer, session: Session, policies: list[str], folder: pathlib.Path) -> None:
        """Draw the session; folder: where recordings are written."""
        self._server, self._session, self._folder = server, session, folder
        self._asked: queue.SimpleQueue[tuple[str, Any]] = queue.SimpleQueue()
        self._drawing = Drawing(server)
        self._policies = policies
        self._panel = Panel(server, policies, session.policy_name, lambda *command: self._asked.put(command))
        self._hint: int | None = None
        self._going_on: Callable[[], None] | None = None
        self._message = ""
        server.scene.on_click()(lambda event: self._asked.put(("click", (event.ray_origin, event.ray_direction))))
        self._commands: dict[str, Callable[[Any], None]] = {
            "click": self._click, "faces": self._set_click(CUT_FACES), "tetrahedra": self._set_click(REMOVE),
            "undo": lambda _: session.undo(), "redo": lambda _: self._redo(), "reset": lambda _: session.begin(session.index),
            "next": lambda _: session.next_scene(), "go to": session.go_to, "play back": self._play_back,
            "policy": self._choose_policy, "hint": self._show_hint, "follow": self._follow, "play on": self._play_on,
            "look": lambda _: None, "heat": self._flip("heat"), "pause": self._flip("pause"), "step": self._step,
            "save": self._save,
        }  # fmt: skip
        self._draw()
        self._drawing.look_at_target(session.scene)

    def run(self, is_stopped: Callable[[], bool]) -> None:
        """Do what is asked for until it is time to stop."""
        last = time.perf_counter()
        while not is_stopped():
            is_busy = self._session.motion.is_moving and not self._panel.pause.value
            try:
                self._do(*self._asked.get(timeout=FRAME if is_busy or self._going_on else IDLE))
            except queue.Empty:
                self._go_on()
            now = time.perf_counter()
            self._let_pass(now - last)
            last = now

    def _do(self, command: str, value: Any) -> None:
        """Do one thing; what is wrong with it is said on the page."""
        if command not in ("look", "heat", "pause"):
            self._hint, self._going_on, self._message = None, None, ""
        try:
            self._commands[command](value)
        except (GmapspringError, OSError) as error:
            self._message = str(error)
        except Exception as error:  # what a browser sends, or a policy does, must not end what others look at
            self._message = f"{type(error).__name__}: {error}"
        # Sliders send more values than can be drawn: only the last is.
        if self._asked.empty() or command != "look":
            self._draw()

    def _let_pass(self, seconds: float) -> None:
        """Let the body move, where it does, by as much as fits the time that has passed [s]."""
        motion = self._session.motion
        if motion.is_moving and not self._panel.pause.value:
            # After a long command the body does not jump.
            motion.advance(min(seconds, 2.0 * FRAME) / max(1.0, float(self._panel.slowness.value)))
            self._draw()

    def _go_on(self) -> None:
        """Make the next cut of what plays by itself, once the body has settled from the last one."""
        if self._going_on is None or self._session.motion.is_moving:
            return
        try:
            self._going_on()
        except GmapspringError as error:
            self._going_on, self._message = None, str(error)
        self._draw()

    # Commands ---------------------------------------------------------------------------------------------------------

    def _click(self, ray: tuple[Any, Any]) -> None:
        """Cut what was clicked."""
        session = self._session
        # Met where it is seen, in the midst of motion too.
        skin, legal = skin_of(session.task.simulation.body, self._shown()), session.legal
        met = hit(*self._drawing.ray(*ray), skin, session.task.simulation.body.nodes.position)
        if met is None:
            return
        if session.moment.is_over:
            raise TopologyError(f"the episode is over ({session.moment.reason}); undo, reset, or go on to the next scene")
        meant = face_cut if self._panel.click.value == CUT_FACES else removal
        action = meant(session.task.table, legal, met)
        if action is None:
            what = "has no face that may be cut" if meant is face_cut else "may not be removed"
            raise TopologyError(f"tetrahedron {met.slot // 4} {what} now")
        self._cut(action)

    def _cut(self, action: int) -> None:
        """Cut, and show how the body settles."""
        self._session.cut(action)
        self._message = f"done: {self._session.describe(action).rstrip(',')}"
        self._session.show_settling()

    def _redo(self) -> None:
        """Do again what was undone, where there is something."""
        if self._session.next_action is not None:
            self._session.redo()
            self._session.show_settling()

    def _choose_policy(self, name: str) -> None:
        """Ask one of the policies of the list, and nobody else, whatever a browser says."""
        if name not in self._policies:
            raise ConfigError(f"there is no policy {name!r} here; choose one of the list")
        self._session.choose_policy(name)

    def _show_hint(self, _: Any) -> None:
        """Show what the policy would do."""
        self._message = f"{self._session.policy_name} is thinking"
        self._show_readings()
        self._hint = self._session.hint()
        self._message = f"{self._session.policy_name} proposes {self._session.describe(self._hint).rstrip(',')}"

    def _follow(self, _: Any) -> None:
        """Do what the policy would do."""
        self._cut(self._session.hint())

    def _play_on(self, _: Any) -> None:
        """Let the policy play until the episode is over."""

        def follow() -> None:
            if self._session.moment.is_over:
                self._going_on = None
            else:
                self._follow(None)

        self._going_on = follow

    def _play_back(self, _: Any) -> None:
        """Go through what was done before and undone since."""

        def redo() -> None:
            self._redo()
            if self._session.next_action is None:
                self._going_on = None

        self._going_on = redo

    def _step(self, _: Any) -> None:
        """Let a moment pass."""
        self._panel.set_value("pause", True)
        self._session.motion.nudge(self._session.task, STEP)

    def _save(self, _: Any) -> None:
        """Write what was done to a file that is not there yet."""
        recording = self._session.recording()
        path = new_file(self._folder, f"{recording.scene}-{recording.split}-{recording.scene_seed}")
        write_recording(path, recording)
        self._panel.show_saved(f"saved as {path}")

    def _set_click(self, what: str) -> Callable[[Any], None]:
        """Return a command that sets what a click does."""
        return lambda _: self._panel.set_value("click", what)

    def _flip(self, name: str) -> Callable[[Any], None]:
        """Return a command that turns a checkbox on or off."""
        return lambda _: self._panel.set_value(name, not getattr(self._panel, name).value)

    # Showing ----------------------------------------------------------------------------------------------------------

    def _shown(self) -> Any:
        """Return the tetrahedra that are not peeled away, bool (n_tetrahedra,)."""
        mesh = self._session.scene.mesh
        side = self._panel.peel.value
        if side == WHOLE or side not in PEELS:
            return np.ones(mesh.n_tetrahedra, dtype=bool)
        along = mesh.points[mesh.tetrahedra].mean(axis=1)[:, "xyz".index(side[-1])]
        share = (along - along.min()) / max(float(np.ptp(along)), 1e-12)
        depth = float(self._panel.depth.value)
        return share <= 1.0 - depth if "+" in side else share >= depth

    def _draw(self) -> None:
        """Bring picture and panel up to date, all in one go."""
        session, panel, drawing = self._session, self._panel, self._drawing
        task, scene, body = session.task, session.scene, session.task.simulation.body
        is_heat, position = panel.heat.value, body.nodes.position
        skin = skin_of(body, self._shown())
        with self._server.atomic():
            drawing.fit(scene)
            drawing.anchors(position[body.nodes.is_pinned])
            paint = paint_strain(task, skin) if is_heat else paint_tissue(scene, task, skin)
            opacity = min(float(panel.opacity.value), 1.0 if self._hint is None else SEEN_THROUGH)
            drawing.body(position, skin, paint, opacity)
            # Where a hint is shown, it is to be seen.
            legal = session.legal & (panel.cuttable.value and self._hint is None)
            edges = cuttable_edges(task.table, legal, skin, is_removing=panel.click.value == REMOVE)
            drawing.lines(position, skin, edges, has_wire=panel.wire.value)
            drawing.hint(position, NO_FACES if self._hint is None else action_corners(task.table, self._hint, body))
            target = skin_of(body, scene.target)
            drawing.inside(position, target.triangles[~target.is_bare] if opacity < 1.0 else NO_FACES)
            nodes = body.vertex_of[scene.target & body.is_alive]
            drawing.load(position[nodes].mean(axis=(0, 1)) if len(nodes) else np.zeros(3), task.load * bool(len(nodes)))
            panel.show_legend(legend(scene.limits.strain, is_heat=is_heat))
            panel.show_place(session.place, session.n_moments)
            self._show_readings()

    def _show_readings(self) -> None:
        """Bring the read-outs up to date."""
        self._panel.show(title_of(self._session), status_of(self._session, self._message), readings(self._session))


def new_file(folder: pathlib.Path, name: str) -> pathlib.Path:
    """Make an empty file that was not there yet, numbered, and return it: two pages never take the same."""
    # A scene's name may be anything: what is neither a letter nor a digit must not lead out of the folder.
    stem = re.sub(r"[^\w.]+", "-", name).strip(".-")
    folder.mkdir(parents=True, exist_ok=True)
    for number in itertools.count(1):
        path = folder / f"{stem}-{number}.json"
        try:
            path.open("x").close()
        except FileExistsError:
            continue
        return path
    raise AssertionError("numbers do not end")
