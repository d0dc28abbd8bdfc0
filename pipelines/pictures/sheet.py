"""Pictures with a line of text each, as one PNG or one moving GIF; what is in the pictures is drawn elsewhere."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import UInt8
from PIL import Image, ImageDraw, ImageFont

_STRIP_PX = 20
_FONT_PX = 13


@dataclass(frozen=True, slots=True)
class Tile:
    """A picture and the line under it."""

    picture: UInt8[np.ndarray, "h w 3"]
    caption: str


def sheet(tiles: Sequence[Tile], n_columns: int, title: str = "") -> bytes:
    """PNG of tiles of one size in rows, each with its caption below, under a title where there is one."""
    height, width = tiles[0].picture.shape[:2]
    n_rows, top = -(-len(tiles) // n_columns), (_STRIP_PX + 4) if title else 0
    image = Image.new("RGB", (n_columns * width, top + n_rows * (height + _STRIP_PX)), "white")
    if title:
        ImageDraw.Draw(image).text((4, 4), title, fill="black", font=ImageFont.load_default(_FONT_PX + 2))
    for k, tile in enumerate(tiles):
        image.paste(_captioned(tile), ((k % n_columns) * width, top + (k // n_columns) * (height + _STRIP_PX)))
    out = io.BytesIO()
    image.save(out, "PNG", optimize=True)
    return out.getvalue()


def moving(tiles: Sequence[Tile], durations_s: Sequence[float]) -> bytes:
    """GIF that shows each tile for its time, again and again.

    Args:
        durations_s: one a tile; GIF counts hundredths of a second.
    """
    images = [_captioned(tile) for tile in tiles]
    # One palette for all: a palette a frame makes still parts flicker. The last frames have every body in view.
    palette = _beside(images[0], images[-1]).quantize(256, method=Image.Quantize.MEDIANCUT)
    frames = [image.quantize(palette=palette, dither=Image.Dither.NONE) for image in images]
    out = io.BytesIO()
    times_ms = [10 * max(1, round(100 * duration_s)) for duration_s in durations_s]
    frames[0].save(out, "GIF", save_all=True, append_images=frames[1:], duration=times_ms, loop=0, optimize=True)
    return out.getvalue()


def _captioned(tile: Tile) -> Image.Image:
    height, width = tile.picture.shape[:2]
    image = Image.new("RGB", (width, height + _STRIP_PX), "white")
    image.paste(Image.fromarray(tile.picture), (0, 0))
    ImageDraw.Draw(image).text((4, height + 2), tile.caption, fill="black", font=ImageFont.load_default(_FONT_PX))
    return image


def _beside(left: Image.Image, right: Image.Image) -> Image.Image:
    both = Image.new("RGB", (left.width + right.width, left.height))
    both.paste(left, (0, 0))
    both.paste(right, (left.width, 0))
    return both
