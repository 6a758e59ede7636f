"""The panel beside the picture: read-outs, buttons and keys. It knows nothing of what they do."""

import html
from collections.abc import Callable, Coroutine, Mapping, Sequence
from typing import Any

import viser

CUT_FACES, REMOVE = "cuts a face", "removes a tetrahedron"
"""What a click does."""
WHOLE = "not at all"
"""A body that is not peeled."""
PEELS = (WHOLE, "from +x", "from -x", "from +y", "from -y", "from +z", "from -z")
"""The sides from which a body may be peeled."""

Tell = Callable[[str, Any], None]
"""Called with the name of a command and what goes with it."""

KEYS: Sequence[tuple[str, str, Any, Any]] = (
    ("faces", "A click cuts a face", "F", None),
    ("tetrahedra", "A click removes a tetrahedron", "T", None),
    ("undo", "Undo", "Z", None),
    ("redo", "Redo", "Z", "shift"),
    ("reset", "Reset the episode", "R", None),
    ("next", "Next scene", "N", None),
    ("hint", "Show the hint", "H", None),
    ("follow", "Do what the hint says", "G", None),
    ("heat", "Strain heat map on or off", "M", None),
    ("pause", "Pause or go on", "space", None),
    ("step", "Let a moment pass", "P", None),
)
"""Keys: command, what it is called, key, key held with it. W, A, S, D, Q, E and arrows move the camera."""


class Panel:
    """The controls; what they are set to can be read off them."""

    def __init__(self, server: viser.ViserServer, policies: Sequence[str], policy: str, tell: Tell) -> None:
        """Make all of it.

        Args:
            server: where it is shown.
            policies: who can be asked for hints.
            policy: who is asked at first.
            tell: told what is wanted.
        """
        self._gui, self._tell = server.gui, tell
        self._gui.configure_theme(control_layout="fixed", control_width="medium", show_logo=False, show_share_button=False)
        self._head = self._gui.add_html("")
        self._legend = self._gui.add_html("")
        self._add_cutting()
        self._add_policy(policies, policy)
        self._add_view()
        self._add_time()
        self._add_recording()
        for command, label, key, held in KEYS:
            self._gui.add_command(label, hotkey=key, modifier=held).on_trigger(self._teller(command))

    def _add_cutting(self) -> None:
        """Add what cuts, and goes back and forth."""
        gui = self._gui
        self.click = gui.add_dropdown("A click", (CUT_FACES, REMOVE), hint="keys F and T")
        with gui.add_folder("Episode"):
            self._buttons("Cuts", {"Undo": "undo", "Redo": "redo", "Play back": "play back"}, "keys Z and shift-Z")
            self._buttons("Scene", {"Reset": "reset", "Next": "next"}, "keys R and N")
            self.place = gui.add_slider("Moment", 0, 1, 1, 0, hint="goes to any moment of the episode")
            self._when_changed(self.place, "go to")

    def _add_policy(self, policies: Sequence[str], policy: str) -> None:
        """Add who gives hints."""
        with self._gui.add_folder("Policy"):
            self.policy = self._gui.add_dropdown("Ask", tuple(policies), initial_value=policy)
            self._when_changed(self.policy, "policy")
            self._buttons("Let it", {"Hint": "hint", "Cut": "follow", "Play on": "play on"}, "keys H and G")

    def _add_view(self) -> None:
        """Add how things look."""
        gui = self._gui
        with gui.add_folder("View"):
            self.heat = gui.add_checkbox("Strain heat map", False, hint="key M")
            self.cuttable = gui.add_checkbox("Edges to cut at", True)
            self.wire = gui.add_checkbox("Mesh lines", True)
            self.opacity = gui.add_slider("Opacity", 0.1, 1.0, 0.05, 1.0)
            self.peel = gui.add_dropdown("Peel", PEELS, hint="takes layers out of sight; what they bare can be clicked")
            self.depth = gui.add_slider("Depth", 0.0, 1.0, 0.02, 0.5)
        for handle in (self.heat, self.cuttable, self.wire, self.opacity, self.peel, self.depth, self.click):
            self._when_changed(handle, "look")

    def _add_time(self) -> None:
        """Add how the body's motion is watched."""
        with self._gui.add_folder("Motion", expand_by_default=False):
            self.pause = self._gui.add_checkbox("Pause", False, hint="space; cuts stay cuts, what is paused is the picture")
            self.slowness = self._gui.add_slider("Slow motion", 1, 50, 1, 8, hint="seconds watched for each second simulated")
            self._buttons("Time", {"Step": "step"}, "key P: lets 5 ms pass, to be seen and then forgotten")

    def _add_recording(self) -> None:
        """Add what keeps an episode."""
        with self._gui.add_folder("Recording", expand_by_default=False):
            self._buttons("Episode", {"Save": "save"}, "up to the moment shown, as a file that training can learn from")
            self._saved = self._gui.add_html("")

    def _when_changed(self, handle: Any, command: str) -> None:
        """Give a command, with the new value, when somebody changes a control; not when the page itself does."""

        # Here and below a coroutine: it is called at once. Others wait for a thread, and find what came after them.
        async def told(event: Any) -> None:
            if event.client_id is not None:
                self._tell(command, handle.value)

        handle.on_update(told)

    def _buttons(self, label: str, commands: Mapping[str, str], hint: str) -> None:
        """Add buttons in a row, each with the command that it gives."""
        group = self._gui.add_button_group(label, tuple(commands), hint=hint)

        async def told(event: Any) -> None:
            self._tell(commands[group.value], None)

        group.on_click(told)

    def _teller(self, command: str) -> Callable[[Any], Coroutine[Any, Any, None]]:
        """Return what gives a command, whatever happened."""

        async def told(event: Any) -> None:
            self._tell(command, None)

        return told

    def set_value(self, name: str, value: Any) -> None:
        """Set a control, by the name of its attribute."""
        getattr(self, name).value = value

    def show(self, title: str, status: tuple[str, str], rows: Mapping[str, str]) -> None:
        """Show a title, how things stand (in words, and as a colour), and read-outs."""
        cells = "".join(
            f'<tr><td style="color:#777;padding-right:1em;white-space:nowrap;vertical-align:top">{name}</td>'
            f'<td data-reading="{name}" style="font-variant-numeric:tabular-nums">{html.escape(value)}</td></tr>'
            for name, value in rows.items()
        )
        words, color = status
        self._head.content = (
            f'<div style="padding:0.2em 0.75em;font-size:0.9em"><b>{html.escape(title)}</b>'
            f'<div id="status" style="margin:0.4em 0;padding:0.3em 0.6em;border-radius:4px;color:white;background:{color}">'
            f"{html.escape(words)}</div><table style=\"line-height:1.35;border-spacing:0\">{cells}</table></div>"
        )

    def show_legend(self, content: str) -> None:
        """Show what colours mean, as HTML."""
        self._legend.content = content

    def show_saved(self, words: str) -> None:
        """Say where a recording lies."""
        self._saved.content = f'<div style="padding:0 0.75em;font-size:0.8em;word-break:break-all">{html.escape(words)}</div>'

    def show_place(self, place: int, n_moments: int) -> None:
        """Move the slider to a moment of the episode."""
        # A slider without room cannot be drawn.
        self.place.max = max(n_moments - 1, 1)
        self.place.disabled = n_moments == 1
        self.set_value("place", place)
