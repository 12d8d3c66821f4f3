"""Reads the tensors of a PyTorch checkpoint without PyTorch and without running anything that the file says.

A checkpoint is a pickle, and a pickle can name any function to call. Here the names that rebuild tensors get our own
readers, every other name gets :class:`Unread`, which does nothing: optimisers, metrics and hostile calls alike. Read are
``torch.save`` files of both layouts, the zip of version 1.6 and later and the stream before it, and ``.npz``.
"""

import pickle
import zipfile
from collections import OrderedDict
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np

STATE = "state_dict"  # under this key a training checkpoint keeps its tensors
STREAM_MAGIC = 0x1950A86A20F9469CFC6C
STREAM_PROTOCOL = 1001
BIG_ENDIAN = "its numbers are big-endian: save it again on a little-endian machine"
ELEMENT_TYPES = {
    "FloatStorage": "<f4", "DoubleStorage": "<f8", "HalfStorage": "<f2", "LongStorage": "<i8", "IntStorage": "<i4",
    "ShortStorage": "<i2", "CharStorage": "|i1", "ByteStorage": "|u1", "BoolStorage": "|b1",
}


class CheckpointError(ValueError):
    """The file cannot be used; the message names it and what to do."""


class Unread:
    """Stands for whatever in the file is no tensor. Takes every operation of a pickle and does nothing."""

    def __new__(cls, *_, **__):
        return super().__new__(cls)

    def __init__(self, *_, **__):
        pass

    def __call__(self, *_, **__):
        return self

    append = extend = add = __setitem__ = __setstate__ = __call__


@dataclass(frozen=True)
class Storage:
    key: str
    element_type: np.dtype
    count: int


@dataclass(frozen=True)
class Tensor:
    """A view of a storage, which the stream layout keeps behind the pickle."""

    storage: Storage
    offset: int
    shape: tuple[int, ...]
    strides: tuple[int, ...]

    def values(self, storage: np.ndarray) -> np.ndarray:
        """A copy of what the view shows; refuses a view that leaves its storage."""
        last = self.offset + sum((size - 1) * stride for size, stride in zip(self.shape, self.strides, strict=True))
        if min((self.offset, *self.shape, *self.strides)) < 0 or (0 not in self.shape and last >= len(storage)):
            raise CheckpointError(f"a tensor of shape {list(self.shape)} leaves its storage of {len(storage)} numbers")
        strides = [stride * storage.itemsize for stride in self.strides]
        return np.lib.stride_tricks.as_strided(storage[self.offset :], self.shape, strides, writeable=False).copy()


def rebuilt_tensor(storage, offset, size, stride, *_) -> Tensor:
    if not isinstance(storage, Storage):
        raise CheckpointError("a tensor has no storage of plain numbers")
    return Tensor(storage, int(offset), tuple(map(int, size)), tuple(map(int, stride)))


def rebuilt_parameter(tensor, *_):
    return tensor


READERS = {
    ("collections", "OrderedDict"): OrderedDict, ("torch", "Size"): tuple,
    ("torch._utils", "_rebuild_tensor_v2"): rebuilt_tensor, ("torch._utils", "_rebuild_parameter"): rebuilt_parameter,
    **{("torch", name): np.dtype(kind) for name, kind in ELEMENT_TYPES.items()},
}


class TensorUnpickler(pickle.Unpickler):
    """Builds containers, numbers, text and tensors; anything else is :class:`Unread`."""

    def __init__(self, file: BinaryIO):
        super().__init__(file, encoding="utf-8")
        self.storages: dict[str, Storage] = {}

    def find_class(self, module: str, name: str):
        return READERS.get((module, name), Unread)

    def persistent_load(self, identity):
        match identity:
            case ("storage", np.dtype() as element_type, key, _, count, *view) if view in ([], [None]):
                return self.storages.setdefault(str(key), Storage(str(key), element_type, int(count)))
        return Unread()


Saved = tuple[object, dict[str, np.ndarray]]  # what the pickle holds, and the numbers of its storages by key


def read_zip(path: Path) -> Saved:
    with zipfile.ZipFile(path) as archive:
        pickles = [name for name in archive.namelist() if name.endswith("/data.pkl")]
        if len(pickles) != 1:
            raise CheckpointError("it is a zip, but not one of torch.save: it holds no data.pkl")
        folder = pickles[0].removesuffix("data.pkl")
        if folder + "byteorder" in archive.namelist() and archive.read(folder + "byteorder") != b"little":
            raise CheckpointError(BIG_ENDIAN)
        with archive.open(pickles[0]) as file:
            unpickler = TensorUnpickler(file)
            saved = unpickler.load()
        storages = unpickler.storages.values()
        return saved, {s.key: np.frombuffer(archive.read(f"{folder}data/{s.key}"), s.element_type, s.count) for s in storages}


def read_stream(path: Path) -> Saved:
    with path.open("rb") as file:
        if TensorUnpickler(file).load() != STREAM_MAGIC or TensorUnpickler(file).load() != STREAM_PROTOCOL:
            raise CheckpointError("it is no file of torch.save")
        if TensorUnpickler(file).load().get("little_endian") is not True:
            raise CheckpointError(BIG_ENDIAN)
        unpickler = TensorUnpickler(file)
        saved = unpickler.load()
        numbers = {}
        for key in TensorUnpickler(file).load():
            if key not in unpickler.storages:
                raise CheckpointError(f"storage {key} holds numbers of an unknown type: save the {STATE} alone, as float32")
            count, element_type = int.from_bytes(file.read(8), "little"), unpickler.storages[key].element_type
            numbers[key] = np.frombuffer(file.read(count * element_type.itemsize), element_type, count)
    return saved, numbers


def read_torch(path: Path) -> dict[str, np.ndarray]:
    saved, numbers = read_zip(path) if zipfile.is_zipfile(path) else read_stream(path)
    state = saved.get(STATE, saved) if isinstance(saved, Mapping) else {}
    found = {name: tensor for name, tensor in state.items() if isinstance(name, str) and isinstance(tensor, Tensor)}
    return {name: tensor.values(numbers[tensor.storage.key]) for name, tensor in found.items()}


def read_npz(path: Path) -> dict[str, np.ndarray]:
    with np.load(path, allow_pickle=False) as arrays:
        return dict(arrays)


def read(path: Path) -> dict[str, np.ndarray]:
    """Name -> values of every tensor of the state in ``path``. Raises :class:`CheckpointError`."""
    if not path.is_file():
        raise CheckpointError(f"{path}: there is no such file")
    try:
        tensors = read_npz(path) if path.suffix == ".npz" else read_torch(path)
    except CheckpointError as error:
        raise CheckpointError(f"{path}: {error}") from error
    except Exception as error:  # a damaged pickle or archive can end in any exception
        raise CheckpointError(f"{path}: it is no checkpoint of torch.save or .npz file, or it is damaged ({error})") from error
    if not tensors:
        raise CheckpointError(f"{path}: it holds no tensors: expected a state dict, or a mapping with one under {STATE!r}")
    return tensors
