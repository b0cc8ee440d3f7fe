"""Films into files: GIF through Pillow, MP4 through ffmpeg, HTML through `player`."""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path

import matplotlib

from graphslam import OptionError
from graphslam.files import write_whole

from ..saving import check_can_write
from .palette import indexed
from .player import page
from .projector import Projector

SUFFIXES = (".gif", ".mp4", ".html")
#: how long the last picture stays before the film begins again [s]
HOLD = 2.0


def check_can_film(path: Path) -> None:
    """Raise now rather than after the work if no film can be written at ``path``.

    Raises:
        OptionError: the suffix is none of `SUFFIXES`, or is .mp4 and there is no ffmpeg.
        FormatError: the place cannot be written.
    """
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise OptionError(f"{path}: the name of a film ends in {', '.join(SUFFIXES[:-1])} or {SUFFIXES[-1]}")
    if suffix == ".mp4":
        _ffmpeg(path)
    check_can_write(path)


def write_film(
    path: Path,
    pictures: Projector,
    fps: float,
    title: str,
    lit: Sequence[int],
    progress: Callable[[], None],
) -> None:
    """Write pictures (height, width, 3) as the suffix says, whole or not at all.

    Raises:
        OptionError: ffmpeg is not installed or fails.
        FormatError: the place cannot be written.
    """
    suffix = path.suffix.lower()
    with write_whole(path) as temporary:
        if suffix == ".gif":
            _write_gif(temporary, pictures, fps, lit, progress)
        elif suffix == ".mp4":
            _write_mp4(temporary, path, pictures, fps, title, progress)
        else:
            temporary.write_text(page(pictures, fps, title, lit, progress), encoding="utf-8")


def _write_gif(path: Path, pictures: Projector, fps: float, lit: Sequence[int], progress: Callable[[], None]) -> None:
    # the format counts hundredths of a second, and viewers take a single one for ten
    duration = max(20, round(100 / fps) * 10)
    durations = [duration] * (len(pictures) - 1) + [max(duration, round(1000 * HOLD))]
    images = (image for _, image in indexed(pictures, lit, progress))
    first = next(images)
    # a file of our own, which is closed when the film is interrupted
    with path.open("wb") as file:
        first.save(
            file, format="GIF", save_all=True, append_images=images, duration=durations, loop=0, disposal=1,
            optimize=False,
        )  # fmt: skip


def _write_mp4(
    path: Path, target: Path, pictures: Projector, fps: float, title: str, progress: Callable[[], None]
) -> None:
    height, width = pictures[0].shape[:2]
    command = [
        _ffmpeg(target), "-loglevel", "error", "-y", "-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}",
        "-r", f"{fps:g}", "-i", "-", "-metadata", f"title={title}", "-pix_fmt", "yuv420p", "-movflags", "+faststart",
        "-f", "mp4", str(path),
    ]  # fmt: skip
    with tempfile.TemporaryFile() as complaints:
        process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=complaints)
        assert process.stdin is not None
        try:
            for picture in pictures:
                process.stdin.write(picture.tobytes())
                progress()
            for _ in range(round(HOLD * fps) - 1):
                process.stdin.write(pictures[-1].tobytes())
        except BrokenPipeError:
            pass  # it has given up; its own words follow
        except BaseException:
            process.kill()
            raise
        finally:
            with suppress(BrokenPipeError):
                process.stdin.close()
            process.wait()
        if process.returncode:
            complaints.seek(0)
            words = complaints.read().decode(errors="replace").strip().splitlines()
            raise OptionError(f"{target}: ffmpeg gave up: {words[-1] if words else f'status {process.returncode}'}")


def _ffmpeg(path: Path) -> str:
    """The program that matplotlib's settings name, by default the ffmpeg on the PATH."""
    found = shutil.which(matplotlib.rcParams["animation.ffmpeg_path"])
    if found is None:
        raise OptionError(f"{path}: .mp4 needs the program ffmpeg: install it, or write a .gif or .html")
    return found
