"""A state dict, checked, as the graphs of its network."""

import dataclasses

import droid as droid_definition
import sea_raft as sea_raft_definition
from graph import Weights, WeightsError


def sea_raft(tensors, size=None):
    """(sidecar's configuration, weights, models by name) of a SEA-RAFT state dict."""
    found = sea_raft_definition.configuration(tensors)
    weights = Weights(tensors)
    graphs = sea_raft_definition.graphs(found, weights)
    weights.check()
    fitting = [name for name, (published, _) in sea_raft_definition.SIZES.items() if published == found]
    if size is not None and size not in fitting:
        what = f"the size of {' or '.join(fitting)}" if fitting else "of no published size"
        raise WeightsError(f"these weights are {what}, not {size}")
    name = size or (fitting[0] if fitting else None)
    iterations = sea_raft_definition.SIZES[name][1] if name else 4
    configuration = {"size": name, "iterations": iterations, **dataclasses.asdict(found)}
    return configuration, weights, {g.name: g.model() for g in graphs}


def droid(tensors):
    """(sidecar's configuration, weights, models by name) of a DROID-SLAM state dict."""
    weights = Weights(droid_definition.state_dict(tensors))
    graphs = droid_definition.graphs(weights)
    weights.check()
    configuration = {"width": droid_definition.HIDDEN, "levels": 4, "radius": 3}
    return configuration, weights, {g.name: g.model() for g in graphs}
