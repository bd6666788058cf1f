"""Reads a checkpoint's tensors into NumPy without PyTorch.

Two formats: PyTorch's zip archive (`.pth`, `torch.save` since 1.6) and safetensors. A `.pth` holds a pickle,
and a pickle may run any code: here it may only name the handful of classes a state dict of tensors
consists of, and whatever else it names is refused.
"""

import collections
import hashlib
import pickle
import zipfile

import numpy as np
import safetensors
import safetensors.numpy


class CheckpointError(Exception):
    """The file is not a checkpoint that can be read; says why and what to do."""


STORAGES = {
    "FloatStorage": np.dtype("<f4"),
    "HalfStorage": np.dtype("<f2"),
    "DoubleStorage": np.dtype("<f8"),
    "LongStorage": np.dtype("<i8"),
    "IntStorage": np.dtype("<i4"),
}
# A checkpoint of these networks has at most 80 MB; a state dict with the optimiser's beside it, thrice that.
LARGEST_BYTES = 1 << 30


class _Storage:
    """Stands for `torch.FloatStorage` and its like, which a pickle names as a class."""

    def __init__(self, dtype):
        self.dtype = dtype


def _tensor(storage, offset, size, stride, *_):
    """What `torch._utils._rebuild_tensor_v2` makes: a view of a storage, here copied."""
    size, stride = tuple(size), tuple(stride)
    if len(size) != len(stride) or any(n < 0 for n in (offset, *size, *stride)):
        raise CheckpointError("a tensor's shape is damaged")
    last = offset + sum((n - 1) * step for n, step in zip(size, stride))
    if 0 not in size and last >= len(storage):
        raise CheckpointError("a tensor reaches beyond its data: the file is damaged or cut short")
    bytes_each = storage.itemsize
    view = np.lib.stride_tricks.as_strided(
        storage[offset:], size, [step * bytes_each for step in stride], writeable=False
    )
    return np.array(view)


def _parameter(tensor, *_):
    """`torch.nn.Parameter` around a tensor: for inference, the tensor."""
    return tensor


class _Unpickler(pickle.Unpickler):
    ALLOWED = {
        ("collections", "OrderedDict"): collections.OrderedDict,
        ("torch._utils", "_rebuild_tensor_v2"): _tensor,
        ("torch._utils", "_rebuild_parameter"): _parameter,
        **{("torch", name): _Storage(dtype) for name, dtype in STORAGES.items()},
    }

    def __init__(self, file, read_storage):
        super().__init__(file)
        self.read_storage = read_storage

    def find_class(self, module, name):
        try:
            return self.ALLOWED[module, name]
        except KeyError:
            raise CheckpointError(
                f"it names {module}.{name}, which a state dict of float or integer tensors does not: "
                "save `model.state_dict()` alone"
            ) from None

    def persistent_load(self, identity):
        kind, storage, key, _location, count = identity
        if kind != "storage" or not isinstance(storage, _Storage):
            raise CheckpointError(f"it refers to an unknown object {identity!r}")
        return self.read_storage(storage.dtype, str(key), int(count))


def _read_pth(path):
    with zipfile.ZipFile(path) as archive:
        entries = {entry.filename: entry for entry in archive.infolist()}
        pickles = [name for name in entries if name.endswith("/data.pkl")]
        if len(pickles) != 1:
            raise CheckpointError("it is a zip archive, but not one that torch.save wrote")
        top = pickles[0].removesuffix("data.pkl")
        if any(entry.compress_type != zipfile.ZIP_STORED for entry in entries.values()):
            raise CheckpointError("its entries are compressed, which torch.save never does")
        if sum(entry.file_size for entry in entries.values()) > LARGEST_BYTES:
            raise CheckpointError(f"it holds more than {LARGEST_BYTES >> 20} MiB")
        if f"{top}byteorder" in entries and archive.read(f"{top}byteorder") != b"little":
            raise CheckpointError("it was written on a big-endian machine")
        storages = {}

        def read_storage(dtype, key, count):
            if key not in storages:
                raw = archive.read(f"{top}data/{key}")
                if len(raw) != count * dtype.itemsize:
                    raise CheckpointError(f"storage {key} has {len(raw)} bytes, not {count} numbers")
                storages[key] = np.frombuffer(raw, dtype)
            return storages[key]

        with archive.open(pickles[0]) as file:
            return _Unpickler(file, read_storage).load()


def read_tensors(path):
    """The tensors of a `.pth` or safetensors file by name, as they are stored."""
    try:
        with open(path, "rb") as file:
            head = file.read(16)
        if head.startswith(b"PK\x03\x04"):
            tensors = _read_pth(path)
        elif head.startswith((b"\x80\x02\x8a\x0a", b"\x80\x02}")):
            raise CheckpointError(
                "it was saved by PyTorch before 1.6: load it with a newer PyTorch and torch.save it again"
            )
        elif head[8:9] == b"{":
            tensors = safetensors.numpy.load_file(path)
        else:
            raise CheckpointError("it is neither a .pth nor a safetensors file")
    except CheckpointError as error:
        raise CheckpointError(f"{path}: {error}") from None
    except OSError as error:
        raise CheckpointError(f"{path}: {error.strerror}") from None
    # Whatever a damaged file makes the readers raise says the same to the user.
    except (
        safetensors.SafetensorError, zipfile.BadZipFile, pickle.UnpicklingError,
        ValueError, TypeError, KeyError, IndexError, AttributeError, EOFError, NotImplementedError,
    ) as error:
        raise CheckpointError(f"{path}: it cannot be read, probably damaged ({error!r})") from None
    if not isinstance(tensors, dict) or not tensors:
        raise CheckpointError(f"{path}: it holds no state dict: save `model.state_dict()` alone")
    for name, tensor in tensors.items():
        if not isinstance(name, str) or not isinstance(tensor, np.ndarray):
            raise CheckpointError(
                f"{path}: {name!r} is no tensor: this is not a plain state dict; save `model.state_dict()` alone"
            )
    return dict(tensors)


def sha256(path):
    """The hexadecimal SHA-256 of a file, as `sha256sum` prints it."""
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
