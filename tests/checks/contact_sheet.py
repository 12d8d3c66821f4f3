"""Puts the previews of a folder on one sheet.

    python contact_sheet.py FOLDER OUT.png [--columns 3] [--width 2400]
"""

from __future__ import annotations

import argparse
from pathlib import Path

from PIL import Image, ImageDraw


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--columns", type=int, default=3)
    parser.add_argument("--width", type=int, default=2400, help="of the sheet, in pixels")
    arguments = parser.parse_args()

    files = sorted(arguments.folder.glob("*.png"))
    if not files:
        parser.error(f"{arguments.folder} has no previews; rig_cases.py --previews makes them")
    cell = arguments.width // arguments.columns
    pictures = []
    for file in files:
        picture = Image.open(file).convert("RGB")
        picture = picture.resize((cell, round(picture.height * cell / picture.width)), Image.Resampling.LANCZOS)
        ImageDraw.Draw(picture).text((8, 6), file.stem, fill=(60, 64, 72))
        pictures.append(picture)
    row = max(picture.height for picture in pictures)
    rows = -(-len(pictures) // arguments.columns)
    sheet = Image.new("RGB", (cell * arguments.columns, row * rows), "white")
    for index, picture in enumerate(pictures):
        sheet.paste(picture, (index % arguments.columns * cell, index // arguments.columns * row))
    sheet.save(arguments.out)
    print(f"{arguments.out}: {len(pictures)} rigs")


if __name__ == "__main__":
    main()
