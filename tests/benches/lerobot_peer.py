"""Helper of lerobot.sh: what lerobot itself writes of clips, and what it reads of a run over them."""

import importlib.metadata
import inspect
import json
import pathlib
import sys

import av
import numpy as np
import pyarrow.parquet
from lerobot.datasets.lerobot_dataset import LeRobotDataset

CAMERA = "observation.images.top"


def pictures(clip):
    with av.open(clip) as container:
        return [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]


def write(root, clips):
    clips = [pictures(clip) for clip in clips]
    state = {"dtype": "float32", "shape": (1,), "names": ["x"]}
    features = {
        CAMERA: {"dtype": "video", "shape": clips[0][0].shape, "names": ["height", "width", "channels"]},
        "observation.state": state,
        "action": state,
    }
    dataset = LeRobotDataset.create(repo_id="a/b", fps=10, root=root, features=features)
    for episode, clip in enumerate(clips):
        for picture in clip:
            value = np.array([episode], np.float32)
            frame = {CAMERA: picture, "observation.state": value, "action": value}
            task = f"task {episode % 2}"
            if "task" in inspect.signature(dataset.add_frame).parameters:
                dataset.add_frame(frame, task)
            else:
                dataset.add_frame(frame | {"task": task})
        dataset.save_episode()
    if hasattr(dataset, "finalize"):
        dataset.finalize()


def read(root, out, kept):
    whole = LeRobotDataset("a/b", root=root)
    frames = whole.hf_dataset.to_pandas()
    rows = [json.loads(line) for line in (out / "scores.jsonl").read_text().splitlines()]
    for row in rows:
        own = frames[frames.episode_index == row["episode_index"]]
        assert row["status"] == "scored" and row["frames"] == len(own), row
    assert len(rows) == whole.num_episodes

    keep, drop = (json.loads((out / "lerobot" / f"{name}_episodes.json").read_text()) for name in ("keep", "drop"))
    assert keep and sorted(keep + drop) == list(range(len(rows))), (keep, drop)
    some = LeRobotDataset("a/b", root=root, episodes=keep)
    assert {int(episode) for episode in some.hf_dataset["episode_index"]} == set(keep)

    rewards = pyarrow.parquet.read_table(out / "lerobot" / "rewards.parquet").to_pandas()
    both = rewards.merge(frames, on="index", suffixes=("", "_of_lerobot"))
    assert len(both) == len(rewards) == len(frames)
    for column in ("episode_index", "frame_index"):
        assert (both[column] == both[f"{column}_of_lerobot"]).all(), column

    deleted = "not tried: this lerobot cannot delete"
    try:
        from lerobot.datasets.dataset_tools import delete_episodes
    except ImportError:
        pass
    else:
        left = delete_episodes(whole, episode_indices=drop, output_dir=kept, repo_id="a/kept")
        assert (left.num_episodes, left.num_frames) == (len(keep), len(some.hf_dataset))
        deleted = f"{left.num_episodes} episodes of {left.num_frames} frames are left"
    version = json.loads((root / "meta" / "info.json").read_text())["codebase_version"]
    print(f"lerobot {importlib.metadata.version('lerobot')}, dataset {version}: {len(rows)} episodes of {len(frames)} frames "
          f"scored; keep {keep} loads; {len(rewards)} frame rewards join; drop {drop} deleted: {deleted}")


command, root, *rest = sys.argv[1:]
match command:
    case "write":
        write(pathlib.Path(root), rest)
    case "read":
        read(pathlib.Path(root), *map(pathlib.Path, rest))
