"""From pictures to files: PNG, a sheet of captioned pictures, GIF, MP4."""

from __future__ import annotations

import io
import math
import os
import zlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from takeapart.formats.documents import write_atomically
from takeapart.formats.messages import shown
from takeapart.model.errors import InputError, MissingExtraError
from takeapart.pictures.renderer import Image

try:
    import imageio.v3 as imageio
    from PIL import Image as PillowImage
    from PIL import ImageDraw, ImageFont
except ImportError as missing:
    raise MissingExtraError("render", "view", "imageio and pillow") from missing

INK, PAPER = (38, 44, 52), (255, 255, 255)
GIF_COLORS = 128
NOTHING = "nothing to show: the plan has no steps"

PathLike = str | os.PathLike[str]


def png_bytes(image: Image, colors: int | None = None) -> bytes:
    """A picture as PNG; with at most so many colours, if given, which makes it several times smaller."""
    picture = PillowImage.fromarray(image)
    if colors is not None:
        picture = picture.quantize(palette=_palette(image, colors), dither=PillowImage.Dither.NONE)
    buffer = io.BytesIO()
    picture.save(buffer, format="PNG", optimize=True)
    return buffer.getvalue()


def save_png(image: Image, path: PathLike) -> None:
    """Write a picture, atomically.

    Raises:
        InputError: the file cannot be written.
    """
    write_atomically(path, png_bytes(image))


def contact_sheet(images: Sequence[Image], captions: Sequence[str], title: str, columns: int | None = None) -> Image:
    """All pictures in rows, each with a caption below it.

    Args:
        columns: by default as many as make the sheet about 4 to 3.
    """
    height, width = images[0].shape[:2]
    band, margin, head = round(height * 0.13), round(width * 0.03), round(height * 0.26)
    columns = columns or max(1, round(math.sqrt(len(images) * 4 / 3 * (height + band) / width)))
    rows = math.ceil(len(images) / columns)
    size = (columns * (width + margin) + margin, head + rows * (height + band + margin) + margin)
    sheet = PillowImage.new("RGB", size, PAPER)
    draw = ImageDraw.Draw(sheet)
    draw.text((margin, head / 2), title, fill=INK, font=ImageFont.load_default(head * 0.42), anchor="lm")
    font = ImageFont.load_default(band * 0.58)
    for number, (image, caption) in enumerate(zip(images, captions, strict=True)):
        x = margin + number % columns * (width + margin)
        y = head + number // columns * (height + band + margin)
        sheet.paste(PillowImage.fromarray(image), (x, y))
        draw.text((x + width * 0.01, y + height + band / 2), caption, fill=INK, font=font, anchor="lm")
    return np.asarray(sheet)


def captioned(image: Image, text: str) -> Image:
    """A picture with a line of text in its upper left corner."""
    picture = PillowImage.fromarray(image)
    size = image.shape[0] * 0.045
    ImageDraw.Draw(picture).text((size * 0.7, size * 0.6), text, fill=INK, font=ImageFont.load_default(size))
    return np.asarray(picture)


def save_animation(frames: Iterable[Image], path: PathLike, frames_per_second: float) -> None:
    """Write a GIF or an MP4, by the ending of the name, atomically.

    Raises:
        InputError: another ending, no frames, or the file cannot be written.
        MissingExtraError: MP4 without ffmpeg.
    """
    where, kind = shown(path), Path(path).suffix.lower()
    if kind not in (".gif", ".mp4"):
        raise InputError(f"unknown ending {kind!r}; an animation is .gif or .mp4", where)
    if kind == ".gif":
        kept = [_Kept.of(frame) for frame in frames]
        if not kept:
            raise InputError(NOTHING, where)
        write_atomically(path, _gif(kept, frames_per_second))
        return
    images = list(frames)
    if not images:
        raise InputError(NOTHING, where)
    try:
        data = imageio.imwrite(
            "<bytes>", np.stack(images), extension=".mp4", plugin="FFMPEG", fps=frames_per_second, macro_block_size=2
        )
    except ImportError as missing:
        raise MissingExtraError("an MP4 file (GIF works without)", "view", "imageio-ffmpeg") from missing
    write_atomically(path, data)


def _palette(image: Image, colors: int) -> PillowImage.Image:
    """The colours of a picture, with as many pixels of parts as of all that is nearly grey: those are far more, and
    would leave no place for the colours of small parts."""
    pixels = image.reshape(-1, 3)
    vivid = np.ptp(pixels.astype(int), axis=1) > 45
    grey = pixels[~vivid]
    if vivid.any():
        grey = grey[:: max(1, len(grey) // int(vivid.sum()))]
    chosen = np.concatenate([pixels[vivid], grey])[None]
    return PillowImage.fromarray(chosen).quantize(colors, method=PillowImage.Quantize.MEDIANCUT)


@dataclass(frozen=True)
class _Kept:
    """A frame, compressed: colours are chosen from all frames, and hundreds of them would take most of a gigabyte."""

    shape: tuple[int, ...]
    content: bytes

    @classmethod
    def of(cls, image: Image) -> _Kept:
        return cls(image.shape, zlib.compress(image.tobytes(), 1))

    @property
    def image(self) -> Image:
        return np.frombuffer(zlib.decompress(self.content), dtype=np.uint8).reshape(self.shape)


def _gif(frames: Sequence[_Kept], frames_per_second: float) -> bytes:
    """All frames with one palette and without dithering, so that what does not move costs nothing."""
    samples = [frame.image[::2, ::2] for frame in frames[:: max(1, len(frames) // 8)]]
    palette = _palette(np.concatenate(samples), GIF_COLORS)
    none = PillowImage.Dither.NONE
    flat = (PillowImage.fromarray(frame.image).quantize(palette=palette, dither=none) for frame in frames)
    buffer = io.BytesIO()
    duration = round(1000 / frames_per_second)
    first = next(flat)
    first.save(buffer, format="GIF", save_all=True, append_images=flat, duration=duration, loop=0, optimize=False)
    return buffer.getvalue()
