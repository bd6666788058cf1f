"""Tests of the converter: reading checkpoints, refusing wrong ones, and what is written.

    python -m unittest test_converter      (from this directory; no PyTorch)

With PLUMBLINE_GOLDEN=DIR the keys of the reference's own state dicts are compared too.
"""

import collections
import io
import json
import os
import pathlib
import pickle
import subprocess
import sys
import tempfile
import types
import unittest
import zipfile

import numpy as np
import safetensors.numpy

import checkpoint
import convert
import graph
import make_probe
import networks
import runtime
import sea_raft
import seeded

HERE = pathlib.Path(__file__).parent
GOLDEN = os.environ.get("PLUMBLINE_GOLDEN")


def torch_stand_ins():
    """Modules by whose names a pickle refers to PyTorch's classes."""
    torch, utils = types.ModuleType("torch"), types.ModuleType("torch._utils")

    def _rebuild_tensor_v2(*_):
        raise AssertionError("only named, never called")

    _rebuild_tensor_v2.__module__, _rebuild_tensor_v2.__qualname__ = "torch._utils", "_rebuild_tensor_v2"
    utils._rebuild_tensor_v2 = _rebuild_tensor_v2
    for name in checkpoint.STORAGES:
        setattr(torch, name, type(name, (), {"__module__": "torch"}))
    return {"torch": torch, "torch._utils": utils}


class TorchFile:
    """Writes what `torch.save` writes, by its format: `archive/data.pkl` and one entry per storage."""

    def __init__(self):
        self.modules = torch_stand_ins()
        self.storages = []

    def tensor(self, storage, offset, size, stride, kind="FloatStorage"):
        """A pickled tensor over a storage, which is a NumPy vector."""
        file = self

        class Stored:
            pass

        class Tensor:
            def __reduce__(self):
                stored = Stored()
                stored.identity = ("storage", getattr(file.modules["torch"], kind), file.key(storage), "cpu", storage.size)
                arguments = (stored, offset, size, stride, False, collections.OrderedDict())
                return file.modules["torch._utils"]._rebuild_tensor_v2, arguments

        return Tensor()

    def key(self, storage):
        for key, known in enumerate(self.storages):
            if known is storage:
                return str(key)
        self.storages.append(storage)
        return str(len(self.storages) - 1)

    def whole(self, array, kind="FloatStorage"):
        """A contiguous tensor with a storage of its own."""
        stride = [step // array.itemsize for step in np.ascontiguousarray(array).strides]
        return self.tensor(np.ascontiguousarray(array).ravel(), 0, array.shape, tuple(stride), kind)

    def save(self, path, value, compression=zipfile.ZIP_STORED):
        class Pickler(pickle.Pickler):
            def persistent_id(self, value):
                return getattr(value, "identity", None)

        buffer = io.BytesIO()
        saved = {name: sys.modules.get(name) for name in self.modules}
        sys.modules.update(self.modules)
        try:
            Pickler(buffer, protocol=2).dump(value)
        finally:
            for name, module in saved.items():
                sys.modules.pop(name) if module is None else sys.modules.update({name: module})
        with zipfile.ZipFile(path, "w", compression) as archive:
            archive.writestr("archive/data.pkl", buffer.getvalue())
            archive.writestr("archive/byteorder", "little")
            for key, storage in enumerate(self.storages):
                archive.writestr(f"archive/data/{key}", storage.tobytes())


class Case(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.folder = pathlib.Path(folder.name)

    def refused(self, path, *words):
        with self.assertRaises(checkpoint.CheckpointError) as caught:
            checkpoint.read_tensors(path)
        for word in (path.name, *words):
            self.assertIn(word, str(caught.exception))


class Reading(Case):
    def test_pth_with_views_shared_storages_and_other_types(self):
        file, path = TorchFile(), self.folder / "a.pth"
        storage = np.arange(24, dtype=np.float32)
        state = collections.OrderedDict(
            whole=file.tensor(storage, 0, (2, 3, 4), (12, 4, 1)),
            transposed=file.tensor(storage, 2, (4, 3), (1, 4)),
            half=file.whole(np.array([1.5, -2], np.float16), "HalfStorage"),
            count=file.tensor(np.array([7]), 0, (), (), "LongStorage"),
        )
        state._metadata = collections.OrderedDict()  # what module.state_dict() hangs on it
        file.save(path, state)
        read = checkpoint.read_tensors(path)
        self.assertEqual(list(read), ["whole", "transposed", "half", "count"])
        np.testing.assert_array_equal(read["whole"], storage.reshape(2, 3, 4))
        np.testing.assert_array_equal(read["transposed"], storage[2:14].reshape(3, 4).T)
        np.testing.assert_array_equal(read["half"], [1.5, -2])
        self.assertEqual(read["count"], 7)

    def test_a_pickle_that_names_a_function_is_refused_unrun(self):
        witness = self.folder / "ran"

        class Attack:
            def __reduce__(self):
                return os.system, (f"touch {witness}",)

        path = self.folder / "attack.pth"
        TorchFile().save(path, {"weight": Attack()})
        self.refused(path, "system")
        self.assertFalse(witness.exists())

    def test_damaged_and_foreign_files_are_refused_by_name(self):
        file, storage = TorchFile(), np.zeros(4, np.float32)
        for name, value, word in [
            ("beyond.pth", {"w": file.tensor(storage, 2, (3,), (1,))}, "beyond"),
            ("negative.pth", {"w": file.tensor(storage, 0, (3,), (-1,))}, "damaged"),
            ("list.pth", [1, 2], "state dict"),
            ("nested.pth", {"model": {"w": 1}, "epoch": 3}, "plain state dict"),
            ("empty.pth", {}, "state dict"),
        ]:
            file.save(self.folder / name, value)
            self.refused(self.folder / name, word)
        good = self.folder / "good.pth"
        file.save(good, {"w": file.whole(np.ones(3000, np.float32))})
        cut = self.folder / "cut.pth"
        cut.write_bytes(good.read_bytes()[:-400])
        self.refused(cut, "damaged")
        turned = bytearray(good.read_bytes())
        turned[turned.find(np.ones(3000, np.float32).tobytes()) + 100] ^= 1
        flipped = self.folder / "flipped.pth"
        flipped.write_bytes(turned)
        self.refused(flipped, "damaged")
        packed = self.folder / "packed.pth"
        file.save(packed, {"w": file.whole(np.ones(3, np.float32))}, zipfile.ZIP_DEFLATED)
        self.refused(packed, "compressed")
        other = self.folder / "other.zip"
        with zipfile.ZipFile(other, "w") as archive:
            archive.writestr("readme", "")
        self.refused(other, "torch.save")
        for name, content, word in [
            ("text.pth", b"not a checkpoint at all", "neither"),
            ("nothing.pth", b"", "neither"),
            ("old.pth", b"\x80\x02\x8a\x0a\x6c\xfc\x9c\x46\xf9\x20\x6a\xa8\x50\x19.", "1.6"),
            ("short.safetensors", b"\xff\0\0\0\0\0\0\0{\"a\":", "damaged"),
        ]:
            (self.folder / name).write_bytes(content)
            self.refused(self.folder / name, word)
        self.refused(self.folder / "absent.pth", "No such file")


class Fitting(Case):
    """A state dict has exactly the network's keys and shapes, or is refused with the key's name."""

    def refuses(self, state, *words, build=networks.sea_raft):
        with self.assertRaises(graph.WeightsError) as caught:
            build(state)
        for word in words:
            self.assertIn(word, str(caught.exception))

    def test_every_kind_of_misfit_is_named(self):
        good = seeded.tensors("sea-raft-s")
        key = "update_block.encoder.convc2.weight"
        missing = {k: v for k, v in good.items() if k != key}
        self.refuses(missing, f"{key} is missing")
        self.refuses(good | {"extra.weight": np.zeros(1)}, "extra.weight is not part")
        self.refuses(good | {key: good[key][:, :-1]}, f"{key} has shape", "255")
        nan = good[key].copy()
        nan[0, 0, 0, 0] = np.nan
        self.refuses(good | {key: nan}, f"{key} has values that are not finite")
        self.refuses({f"module.{k}": v for k, v in good.items()}, "no SEA-RAFT")
        twin = "cnet.layer2.0.downsample.1.bias"
        self.refuses(good | {twin: good[twin] + 1}, twin, "differ")
        self.refuses(seeded.tensors("droid"), "no SEA-RAFT")
        self.refuses(good, "no DROID-SLAM", build=networks.droid)
        reduced = {k: v[..., :1] for k, v in good.items() if v.ndim == 4 and "flow_head" not in k and "convc1" not in k}
        self.refuses(good | reduced, "and", "more")
        half = {f"module.{k}" if n % 2 else k: v for n, (k, v) in enumerate(seeded.tensors("droid").items())}
        self.refuses(half, "module.", build=networks.droid)

    def test_a_tensor_stored_once_under_either_name_fits(self):
        """Writers of safetensors drop the second name of a shared tensor."""
        good = seeded.tensors("sea-raft-s")
        for dropped in (".bn3.", ".downsample.1."):
            state = {key: value for key, value in good.items() if dropped not in key}
            self.assertLess(len(state), len(good))
            for found, expected in zip(networks.sea_raft(state)[2].values(), networks.sea_raft(good)[2].values()):
                self.assertEqual([n.op_type for n in found.graph.node], [n.op_type for n in expected.graph.node])
        neither = {k: v for k, v in good.items() if ".bn3." not in k and ".downsample.1." not in k}
        self.refuses(neither, "fnet.layer2.0.bn3.weight is missing")

    def test_sizes(self):
        medium = seeded.tensors("sea-raft-m")
        for size, iterations in ((None, 4), ("M", 4), ("L", 12)):
            configuration, weights, _ = networks.sea_raft(medium, size)
            self.assertEqual((configuration["size"], configuration["iterations"]), (size or "M", iterations))
            self.assertEqual(weights.parameters(), 19_663_876)
        with self.assertRaisesRegex(graph.WeightsError, "size of M or L, not S"):
            networks.sea_raft(medium, "S")
        small = networks.sea_raft(seeded.tensors("sea-raft-s"))[0]
        self.assertEqual((small["size"], small["blocks"]), ("S", (2, 2, 2)))

    def test_parts_have_the_published_counts(self):
        """`sea_raft.md` counts the parameters of every part of M; DROID's are counted in its goldens' text."""
        asked = graph.Weights(None)
        sea_raft.graphs(sea_raft.MEDIUM, asked)
        counts = collections.Counter()
        for key, shape in asked.asked.items():
            if ".running_" not in key:
                counts[key.split(".")[0]] += int(np.prod(shape))
        self.assertEqual(counts, {
            "cnet": 8_250_432, "fnet": 8_241_024, "update_block": 1_830_142, "init_conv": 590_080,
            "upsample_weight": 443_200, "flow_head": 308_998,
        })
        weights = networks.droid(seeded.tensors("droid"))[1]
        self.assertEqual((weights.parameters(), len(weights.asked)), (4_002_565, 102))

    @unittest.skipUnless(GOLDEN, "skipped: no PLUMBLINE_GOLDEN")
    def test_the_reference_state_dicts_have_the_same_keys(self):
        for archive, name in (("sea_raft_small.npz", "sea-raft-m"), ("droid_nets.npz", "droid")):
            with np.load(pathlib.Path(GOLDEN) / archive) as golden:
                keys = {k.removeprefix("sd/") for k in golden.files if k.startswith("sd/")}
            counters = {k for k in keys if k.endswith("num_batches_tracked")}
            self.assertEqual(set(seeded.tensors(name)), keys - counters)

    def test_droids_file_has_a_prefix_and_a_third_output(self):
        plain = seeded.tensors("droid")
        published = {}
        for key, value in plain.items():
            if key.startswith(("update.delta.2", "update.weight.2")):
                value = np.concatenate([value, value[:1] + 1])
            published[f"module.{key}"] = value
        for found, expected in zip(networks.droid(published)[2].values(), networks.droid(plain)[2].values()):
            self.assertEqual(found, expected)


class Writing(Case):
    def test_same_checkpoint_same_bytes_and_the_sidecar_tells_them(self):
        path = self.folder / "droid.safetensors"
        safetensors.numpy.save_file(seeded.tensors("droid"), path)
        first = convert.convert("droid", path, self.folder / "a")
        convert.convert("droid", path, self.folder / "b")
        written = sorted(p.name for p in (self.folder / "a").iterdir())
        self.assertEqual(written, sorted(["model.json", *(f"{n}.onnx" for n in first["graphs"])]))
        for name in written:
            self.assertEqual((self.folder / "a" / name).read_bytes(), (self.folder / "b" / name).read_bytes())
        sidecar = json.loads((self.folder / "a" / "model.json").read_text())
        self.assertEqual(sidecar, first)
        self.assertEqual(sidecar["source"]["sha256"], checkpoint.sha256(path))
        for entry in sidecar["graphs"].values():
            self.assertEqual(entry["sha256"], checkpoint.sha256(self.folder / "a" / entry["file"]))
        self.assertEqual(sidecar["graphs"]["update"]["inputs"]["correlation"], ["edges", 196, "rows", "columns"])

    def test_the_probe_in_the_source_is_the_one_made_here(self):
        written = HERE.parents[1] / "worker" / "src" / "learned" / "probe.onnx"
        self.assertEqual(written.read_bytes(), make_probe.model().SerializeToString(deterministic=True))

    def test_a_batch_is_its_items_and_any_size_runs(self):
        _, _, models = networks.droid(seeded.tensors("droid"))
        update = runtime.session(models["update"].SerializeToString())
        aggregate = runtime.session(models["aggregate"].SerializeToString())
        rng = np.random.default_rng(1)
        for rows, columns in ((4, 7), (16, 5)):
            edges = {
                name: rng.uniform(-1, 1, (5, width, rows, columns)).astype(np.float32)
                for name, width in (("net", 128), ("gates", 384), ("correlation", 196), ("motion", 4))
            }
            together = runtime.run(update, **edges)
            for edge in range(5):
                alone = runtime.run(update, **{name: value[edge : edge + 1] for name, value in edges.items()})
                for name, value in alone.items():
                    np.testing.assert_allclose(together[name][edge], value[0], atol=2e-6)
            # Two sources with three and two edges: as each with its own edges alone.
            averages = np.array([[1 / 3, 0, 1 / 3, 0, 1 / 3], [0, 1 / 2, 0, 1 / 2, 0]], np.float32)
            both = runtime.run(aggregate, net=edges["net"], averages=averages)
            self.assertEqual(both["damping"].shape, (2, 1, rows, columns))
            for source, row in enumerate(averages):
                mine = row > 0
                one = runtime.run(aggregate, net=edges["net"][mine], averages=row[mine][None])
                np.testing.assert_allclose(both["damping"][source], one["damping"][0], atol=2e-6)

    def test_commands_fail_in_one_line(self):
        wrong = self.folder / "wrong.pth"
        wrong.write_text("no checkpoint")
        droid = self.folder / "droid.safetensors"
        safetensors.numpy.save_file(seeded.tensors("droid"), droid)
        taken = self.folder / "taken"
        taken.mkdir()
        for arguments, word in [
            (["sea-raft", wrong, "--out", self.folder / "o"], "neither a .pth nor"),
            (["sea-raft", droid, "--out", self.folder / "o"], "no SEA-RAFT"),
            (["droid", droid, "--out", taken], "exists"),
            (["droid", droid, "--out", self.folder / "o", "--golden", self.folder], "droid_nets.npz"),
        ]:
            run = subprocess.run(
                [sys.executable, "-B", HERE / "convert.py", *arguments], capture_output=True, text=True
            )
            self.assertEqual(run.returncode, 1, run.stderr)
            self.assertEqual(len(run.stderr.splitlines()), 1, run.stderr)
            self.assertIn(word, run.stderr)

    def test_a_whole_conversion_is_checked_and_exits_well(self):
        path = self.folder / "m.safetensors"
        safetensors.numpy.save_file(seeded.tensors("sea-raft-m"), path)
        run = subprocess.run(
            [sys.executable, "-B", HERE / "convert.py", "sea-raft", path, "--size", "L", "--out", self.folder / "o"],
            capture_output=True, text=True,
        )
        self.assertEqual(run.returncode, 0, run.stderr)
        self.assertIn("19,663,876 parameters", run.stdout)
        self.assertNotIn("TOO MUCH", run.stdout)
        self.assertEqual(json.loads((self.folder / "o" / "model.json").read_text())["configuration"]["iterations"], 12)


if __name__ == "__main__":
    unittest.main()
