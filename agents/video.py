"""Videos of episodes: policies side by side on the same scenes, as GIF, animated WebP, or mp4."""

import importlib
import io
import pathlib
import tempfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from agents.evaluation import Episode, Policy, play_episode
from agents.film import Filmed, Reel
from envs.frames import Frames
from envs.resect import ResectEnv
from gmapspring.config import closest
from gmapspring.errors import ConfigError
from gmapspring.paths import write_atomically
from gmapspring.rendering.style import Style

Array = np.ndarray[Any, Any]

SIDE = 320
"""Width and height of each policy's picture [pixels]."""

STRIP = 40
"""Height of the strip under it [pixels]: a line for the name, one for how the episode stands."""

FRAMES_PER_SECOND = 12

HOLD = (10, 18)
"""Frames for which the first and the last picture of an episode stay."""

MOST_PLAYERS = 4
"""Policies that fit side by side."""

PALE = (0.93, 0.945, 0.96)
LOOK = Style(background=(PALE, PALE), wire=0.2)
"""One colour behind the body: a gradient would take most of a GIF's colours, and its bytes."""

N_COLORS = 64
"""Colours of a GIF."""

UNSEEN = 12
"""Difference of red, green or blue, of 255, up to which a pixel of a GIF keeps the colour that it had a frame before."""

INK, FAINT = (38, 44, 54), (96, 106, 120)
"""Colours of the two lines of text."""


@dataclass(frozen=True)
class Player:
    """A policy, and the environment that it plays."""

    name: str
    """What to call it."""
    policy: Policy
    """Who plays; scripted ones are bound to the environment."""
    env: ResectEnv
    """What it plays; not wrapped, and with any render mode."""


def record_video(
    players: Sequence[Player], path: pathlib.Path, indices: Iterable[int] = (0,), seed: int = 0, style: str = "tissue"
) -> list[Episode]:
    """Play episodes, write a video of them, and return them, player by player for each scene.

    Args:
        players: at most four, side by side; whoever is done first waits for the others.
        path: *.gif, *.webp or *.mp4.
        indices: which scenes of the environments' list, one after another.
        seed: of the first episode; the others count up from it, as in `evaluate`.
        style: of frames, see `envs.frames.STYLES`.

    Raises:
        ConfigError: the file's kind is unknown or needs a package, there are no players, or too many.
    """
    encode = check_video(path, len(players))
    pictures: list[Array] = []
    episodes = []
    for number, index in enumerate(indices):
        reels = []
        for player in players:
            filmed = Filmed(player.env, Frames(style, (SIDE, SIDE), LOOK))
            episodes.append(play_episode(player.policy, filmed, player.name, seed + number, index))
            reels.append(filmed.reel)
        pictures += side_by_side([player.name for player in players], reels)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, encode(pictures))
    return episodes


def side_by_side(names: Sequence[str], reels: Sequence[Reel]) -> list[Array]:
    """Return the frames of several reels beside each other, captions below; those of an episode's ends are held."""
    n_frames = max(len(reel.frames) for reel in reels)
    pictures = []
    for place in range(n_frames):
        columns = []
        for name, reel in zip(names, reels, strict=True):
            now = min(place, len(reel.frames) - 1)
            columns.append(np.concatenate([reel.frames[now], caption(name, reel.captions[now], reel.frames[now].shape[1])]))
        pictures.append(np.concatenate(columns, axis=1))
    return [pictures[0]] * (HOLD[0] - 1) + pictures + [pictures[-1]] * (HOLD[1] - 1)


def caption(name: str, text: str, width: int) -> Array:
    """Return a strip with two lines of text, uint8 (STRIP, width, 3)."""
    strip = Image.new("RGB", (width, STRIP), (255, 255, 255))
    pen = ImageDraw.Draw(strip)
    for line, (words, size, ink) in enumerate(((name, 14, INK), (text, 12, FAINT))):
        font = ImageFont.load_default(size)
        pen.text((10, 16 + 18 * line), fitting(words, font.getlength, width - 20), ink, font, anchor="ls")
    return np.asarray(strip)


def fitting(words: str, length: Callable[[str], float], room: float) -> str:
    """Return words, cut short in front where they are too long: of a path, the end tells most."""
    shown = words
    while length(shown) > room and len(words) > 1:
        words = words[1:]
        shown = "..." + words
    return shown


def as_gif(pictures: Sequence[Array]) -> bytes:
    """Return an animated GIF, in one palette for all frames, so that what rests takes no room."""
    sample = np.concatenate(pictures[:: max(1, len(pictures) // 12)])
    palette = Image.fromarray(sample).quantize(N_COLORS, Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE)
    colors = np.array(palette.getpalette(), dtype=np.int16).reshape(-1, 3)
    frames, shown = [], None
    for picture in pictures:
        pixels = np.array(Image.fromarray(picture).quantize(palette=palette, dither=Image.Dither.NONE))
        if shown is not None:
            # What differs too little to be noticed stays as it is: most of a GIF is paid for such pixels.
            is_same = np.abs(colors[shown] - picture).max(axis=2) <= UNSEEN
            pixels = np.where(is_same, shown, pixels)
        frames.append(Image.fromarray(pixels))
        frames[-1].putpalette(palette.getpalette() or [])
        shown = pixels
    # GIF counts time in hundredths of a second.
    return _saved(frames, "GIF", duration=round(100 / FRAMES_PER_SECOND) * 10, loop=0, optimize=True)


def as_webp(pictures: Sequence[Array]) -> bytes:
    """Return an animated WebP."""
    frames = [Image.fromarray(picture) for picture in pictures]
    return _saved(frames, "WEBP", duration=round(1000 / FRAMES_PER_SECOND), loop=0, quality=75, method=4)


def as_mp4(pictures: Sequence[Array]) -> bytes:
    """Return an mp4 (H.264)."""
    ffmpeg = _ffmpeg()
    with tempfile.TemporaryDirectory() as folder:
        path = pathlib.Path(folder) / "video.mp4"
        height, width = pictures[0].shape[:2]
        writer = ffmpeg.write_frames(str(path), (width, height), fps=FRAMES_PER_SECOND, macro_block_size=2)
        writer.send(None)
        for picture in pictures:
            writer.send(np.ascontiguousarray(picture))
        writer.close()
        return path.read_bytes()


ENCODERS: Mapping[str, Callable[[Sequence[Array]], bytes]] = {".gif": as_gif, ".webp": as_webp, ".mp4": as_mp4}
"""How videos are written, by the ending of their file."""


def check_video(path: pathlib.Path, n_players: int) -> Callable[[Sequence[Array]], bytes]:
    """Return what will write a video of so many policies, or raise `ConfigError` before anything is played."""
    if not 1 <= n_players <= MOST_PLAYERS:
        raise ConfigError(f"a video shows 1 to {MOST_PLAYERS} policies side by side, not {n_players}")
    return encoder_of(path)


def encoder_of(path: pathlib.Path) -> Callable[[Sequence[Array]], bytes]:
    """Return what writes a file of this kind; what it needs is looked for now, before anything is played."""
    kind = path.suffix.lower()
    if kind not in ENCODERS:
        known = ", ".join(ENCODERS)
        raise ConfigError(f"cannot write a video to {path}: its ending must be one of {known}; {closest(kind, ENCODERS)}")
    if path.is_dir():
        raise ConfigError(f"cannot write a video to {path}: it is a folder; give the name of a file")
    if kind == ".mp4":
        _ffmpeg()
    return ENCODERS[kind]


def _ffmpeg() -> Any:
    """Return the package that writes mp4."""
    try:
        imageio_ffmpeg = importlib.import_module("imageio_ffmpeg")
    except ImportError:
        raise ConfigError('an mp4 needs imageio-ffmpeg: pip install "gmapspring[video]"; .gif and .webp need nothing') from None
    return imageio_ffmpeg


def _saved(frames: Sequence[Image.Image], kind: str, **settings: Any) -> bytes:
    """Return an animation as bytes."""
    stream = io.BytesIO()
    frames[0].save(stream, kind, save_all=True, append_images=frames[1:], **settings)
    return stream.getvalue()
