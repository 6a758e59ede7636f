"""A window for frames, for `render_mode="human"`; where there is no display, a plain word on how to see instead."""

import warnings
from typing import Any

import numpy as np

Array = np.ndarray[Any, Any]

ADVICE = (
    "there is no display to show frames on ({reason}), so the episode goes on unseen; to see it, make the environment with "
    'render_mode="rgb_array" and keep what env.render() returns, or watch it in a browser: gmapspring view'
)
"""What is said once, where frames cannot be shown."""


class Window:
    """Show frames one after another by matplotlib, which finds out by itself what displays there are."""

    def __init__(self, title: str, frames_per_second: float) -> None:
        """Open nothing yet: the first frame does."""
        self._title, self._seconds = title, 1.0 / frames_per_second
        self._figure: Any = None
        self._image: Any = None
        self._is_given_up = False

    def show(self, frame: Array) -> None:
        """Show a frame, uint8 (height, width, 3), for as long as it lasts; nothing once the window has been shut by hand."""
        if self._is_given_up:
            return
        if self._figure is None and not self._open(frame):
            return
        import matplotlib.pyplot as plt

        if not plt.fignum_exists(self._figure.number):
            self._is_given_up = True
            return
        self._image.set_data(frame)
        plt.pause(self._seconds)

    def close(self) -> None:
        """Shut the window."""
        if self._figure is not None:
            import matplotlib.pyplot as plt

            plt.close(self._figure)
        self._figure = self._image = None

    def _open(self, frame: Array) -> bool:
        """Open a window of a frame's size, or say how to see without one; return whether it is open."""
        import matplotlib.pyplot as plt

        try:
            # A bar of tools would widen the window beyond the frame, which then is drawn larger than it is.
            with plt.rc_context({"toolbar": "None"}):
                figure = plt.figure(self._title, figsize=(frame.shape[1] / 100, frame.shape[0] / 100), dpi=100)
        except Exception as error:  # each toolkit has errors of its own for a display that it cannot reach
            return self._give_up(str(error).splitlines()[0] if str(error) else type(error).__name__)
        if type(figure.canvas).required_interactive_framework is None:
            plt.close(figure)
            return self._give_up(f"matplotlib draws by {plt.get_backend()}")
        axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
        axes.set_axis_off()
        self._figure, self._image = figure, axes.imshow(frame)
        return True

    def _give_up(self, reason: str) -> bool:
        """Say once why nothing is shown; return False."""
        self._is_given_up = True
        warnings.warn(ADVICE.format(reason=reason), stacklevel=5)
        return False
