"""Cache files made small enough to travel to the machine that trains the joint networks.

    python -m rigsmith_models.data.travel CACHE/train.npz CACHE/synthetic0.npz -o train.travel
    ... CACHE/train.npz CACHE/train2.npz --families 32 -o mem.travel      so many that are unlike each other, to be learnt by heart

A travel file holds what displacement and attention are trained on, nothing for the later stages: positions and offsets rounded to
1/16384 of the character's size, at most 6 + 12 neighbours a vertex, weights in 255ths, vertices in the order of a space-filling
curve, which makes neighbours' indices alike. It is an npz in an xz stream, about a third of what zip would make of it.
"""

import argparse
import io
import json
import lzma
from dataclasses import replace
from pathlib import Path

import numpy as np

from .character import Character, read_cache

GRID = 16384
ONE_RING_COLUMNS, BALL_COLUMNS = 6, 12
CURVE_BITS = 7
FIELDS = ("positions", "medial_offsets", "one_ring", "geodesic_ball", "joints", "parents", "skin_weights", "attention_mask", "tolerance")


def curve_order(positions: np.ndarray) -> np.ndarray:
    """Order of the vertices along a Z-curve of 128 cells a side."""
    cell = np.clip((positions - positions.min(0)) * (1 << CURVE_BITS), 0, (1 << CURVE_BITS) - 1).astype(np.int64)
    code = sum(((cell[:, axis] >> bit) & 1) << (3 * bit + axis) for bit in range(CURVE_BITS) for axis in range(3))
    return np.argsort(code, kind="stable")


def fewer_columns(table: np.ndarray, columns: int, rng: np.random.Generator) -> np.ndarray:
    """A random choice of each row's neighbours, in ascending order, the own index last where there are fewer."""
    own = np.arange(len(table))[:, None]
    absent = table == own
    chosen = (rng.random(table.shape) + absent).argsort(1)[:, :columns]
    picked, gone = np.take_along_axis(table, chosen, 1), np.take_along_axis(absent, chosen, 1)
    last = np.where(gone, len(table), picked)
    last.sort(axis=1)
    return np.where(last == len(table), own, last)


def small(character: Character, rng: np.random.Generator) -> dict[str, np.ndarray]:
    """The arrays of a travel file; ``large`` turns them back."""
    order = curve_order(character.positions)
    new_index = np.empty(len(order), np.int64)
    new_index[order] = np.arange(len(order))
    own = np.arange(len(order))[:, None]
    tables = (fewer_columns(new_index[table[order]], columns, rng) - own for table, columns in (
        (character.one_ring, ONE_RING_COLUMNS), (character.geodesic_ball, BALL_COLUMNS)))
    one_ring, ball = (table.astype(np.int16).T.copy() for table in tables)
    return {
        "positions": np.round(character.positions[order] * GRID).astype(np.int16).T.copy(),
        "medial_offsets": np.round(character.medial_offsets[order] * GRID / 8).astype(np.int16).T.copy(),
        "one_ring": one_ring, "geodesic_ball": ball, "joints": character.joints, "parents": character.parents,
        "skin_weights": np.round(character.skin_weights[order].astype(np.float32) * 255).astype(np.uint8).T.copy(),
        "attention_mask": character.attention_mask[order], "tolerance": character.tolerance,
    }


def large(arrays: dict[str, np.ndarray], meta: dict) -> Character:
    own = np.arange(arrays["positions"].shape[1])[:, None]
    weights = arrays["skin_weights"].T.astype(np.float32)
    return Character(
        positions=(arrays["positions"].T / np.float32(GRID)).astype(np.float32),
        medial_offsets=(arrays["medial_offsets"].T / np.float32(GRID / 8)).astype(np.float32),
        one_ring=arrays["one_ring"].T.astype(np.int32) + own, geodesic_ball=arrays["geodesic_ball"].T.astype(np.int32) + own,
        joints=arrays["joints"], parents=arrays["parents"],
        skin_weights=(weights / np.maximum(weights.sum(1, keepdims=True), 1)).astype(np.float16),
        attention_mask=arrays["attention_mask"], tolerance=arrays["tolerance"], meta=meta)


def write_travel(path: Path, characters: list[Character]) -> None:
    rng = np.random.default_rng(5)
    made = [small(character, rng) for character in characters]
    # Field by field, so that like stands beside like.
    arrays = {f"{name}/{k:04d}": one[name] for name in FIELDS for k, one in enumerate(made)}
    arrays["meta_json"] = np.frombuffer(json.dumps([c.meta for c in characters]).encode(), np.uint8)
    stream = io.BytesIO()
    np.savez(stream, **arrays)
    path.write_bytes(lzma.compress(stream.getvalue(), preset=6))


def read_travel(path: Path) -> list[Character]:
    with np.load(io.BytesIO(lzma.decompress(path.read_bytes()))) as archive:
        metas = json.loads(bytes(archive["meta_json"]))
        return [large({name: archive[f"{name}/{k:04d}"] for name in FIELDS}, meta) for k, meta in enumerate(metas)]


def unlike(characters: list[Character], count: int) -> list[Character]:
    """One character of each family that is not made of boxes, so many of these, evenly spread over the list, all drawn equally."""
    families: dict[str, Character] = {}
    for character in characters:
        if character.meta["style"] != "box":
            families.setdefault(character.meta["family"], character)
    firsts = list(families.values())
    chosen = firsts[:: max(1, len(firsts) // count)][:count]
    return [replace(character, meta={**character.meta, "draw_weight": 1.0}) for character in chosen]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("caches", type=Path, nargs="+")
    parser.add_argument("--families", type=int, help="only one character of each of so many families, none made of boxes")
    parser.add_argument("-o", "--output", type=Path, required=True)
    arguments = parser.parse_args()
    characters = [c for cache in arguments.caches for c in read_cache(cache)]
    if arguments.families:
        characters = unlike(characters, arguments.families)
    write_travel(arguments.output, characters)
    print(f"{arguments.output.name}: {len(characters)} characters, {arguments.output.stat().st_size / 2**20:.1f} MiB")


if __name__ == "__main__":
    main()
