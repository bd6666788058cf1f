"""Builds ONNX graphs from a state dict: convolutions, norms and activations by the names of their weights.

Every weight is asked for by name and shape. What a network asked for and what the checkpoint holds are
compared at the end (`Weights.check`): there is no other list of keys, so a graph cannot be built from a
checkpoint that does not fit it.
"""

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

OPSET = 20  # the first with Gelu; read by ONNX Runtime since 1.17
IR_VERSION = 9
NORM_EPSILON = 1e-5


class WeightsError(Exception):
    """A checkpoint does not fit the network; says which keys."""


class Weights:
    """A checkpoint's tensors, with a record of which were asked for.

    With `tensors=None` every weight is zero: to learn what a network asks for (`asked`).
    """

    def __init__(self, tensors):
        self.tensors = tensors
        self.asked = {}  # key -> shape
        self.optional = set()
        self.wrong = []

    def take(self, key, shape):
        """The tensor of that key as float32; zeros, and an entry for `check`, where it does not fit."""
        shape = tuple(shape)
        self.asked[key] = shape
        if self.tensors is None:
            return np.zeros(shape, np.float32)
        if key not in self.tensors:
            self.wrong.append(f"{key} is missing")
        elif self.tensors[key].shape != shape:
            self.wrong.append(f"{key} has shape {list(self.tensors[key].shape)}, not {list(shape)}")
        else:
            value = self.tensors[key].astype(np.float32)
            if not np.isfinite(value).all():
                self.wrong.append(f"{key} has values that are not finite")
            return value
        return np.zeros(shape, np.float32)

    def ignore(self, key):
        """A key that may be there and means nothing to inference."""
        self.optional.add(key)

    def take_twin(self, key, twin, shape):
        """A tensor that the checkpoint may hold under either of two names, or under both alike."""
        if self.tensors is not None:
            present = [name for name in (key, twin) if name in self.tensors]
            if len(present) == 2 and not np.array_equal(self.tensors[key], self.tensors[twin]):
                self.wrong.append(f"{key} and {twin} differ, where they are one tensor")
            if present:
                self.optional.add(twin if present[0] == key else key)
                return self.take(present[0], shape)
        self.optional.add(twin)
        return self.take(key, shape)

    def parameters(self):
        """How many numbers the network asked for that training sets (running statistics are not)."""
        return sum(
            int(np.prod(shape)) for key, shape in self.asked.items() if ".running_" not in key
        )

    def check(self):
        """Raises unless the checkpoint holds exactly what was asked for."""
        known = self.asked.keys() | self.optional
        wrong = list(dict.fromkeys(self.wrong))
        wrong += [f"{key} is not part of the network" for key in self.tensors if key not in known]
        if wrong:
            shown = wrong[:6] + ([f"and {len(wrong) - 6} more"] if len(wrong) > 6 else [])
            raise WeightsError("; ".join(shown))


class Graph:
    """One ONNX graph under construction. Tensors are named by what made them (a convolution's output by
    its key), so that a check can ask for inner ones."""

    def __init__(self, name, weights):
        self.name = name
        self.weights = weights
        self.nodes, self.inputs, self.outputs = [], [], []
        self.initializers = {}

    def input(self, name, shape):
        """A float32 input; `shape` mixes sizes and names of sizes known at run time."""
        self.inputs.append(helper.make_tensor_value_info(name, TensorProto.FLOAT, shape))
        return name

    def output(self, name, tensor, shape):
        """Makes a tensor an output under a name of its own."""
        self.node("Identity", [tensor], name=name)
        self.outputs.append(helper.make_tensor_value_info(name, TensorProto.FLOAT, shape))

    def node(self, op, inputs, name=None, **attributes):
        """Adds an operation with one output and returns the output's name."""
        name = name or f"{op.lower()}_{len(self.nodes)}"
        self.nodes.append(helper.make_node(op, inputs, [name], name=name, **attributes))
        return name

    def constant(self, name, value):
        """A constant tensor."""
        self.initializers.setdefault(name, numpy_helper.from_array(np.ascontiguousarray(value), name))
        return name

    def weight(self, key, shape):
        """A weight as a constant."""
        return self.constant(key, self.weights.take(key, shape))

    def conv(self, x, key, channels_in, channels_out, kernel, stride=1, groups=1):
        """A square convolution with a bias, zero-padded by half its kernel."""
        weight = self.weight(f"{key}.weight", (channels_out, channels_in // groups, kernel, kernel))
        bias = self.weight(f"{key}.bias", (channels_out,))
        return self.node(
            "Conv", [x, weight, bias], name=key, kernel_shape=[kernel] * 2, strides=[stride] * 2,
            pads=[kernel // 2] * 4, group=groups,
        )

    def linear(self, x, key, width_in, width_out):
        """A linear layer over the last axis."""
        weight = self.weights.take(f"{key}.weight", (width_out, width_in))
        product = self.node("MatMul", [x, self.constant(f"{key}.weight", weight.T)])
        return self.node("Add", [product, self.weight(f"{key}.bias", (width_out,))], name=key)

    def _norm_parts(self, key, channels, twin=None):
        """A batch normalisation's tensors by name, in the order of ONNX."""
        for name in (key, twin):
            if name:
                self.weights.ignore(f"{name}.num_batches_tracked")
        return {
            part: self.weights.take_twin(f"{key}.{part}", f"{twin}.{part}", (channels,))
            if twin else self.weights.take(f"{key}.{part}", (channels,))
            for part in ("weight", "bias", "running_mean", "running_var")
        }

    def batch_norm(self, x, key, channels, twin=None):
        """Batch normalisation by its running statistics, epsilon 1e-5. `twin` is a second name under
        which the same tensors may be stored."""
        parts = self._norm_parts(key, channels, twin).items()
        inputs = [self.constant(f"{key}.{part}", value) for part, value in parts]
        return self.node("BatchNormalization", [x, *inputs], name=key, epsilon=NORM_EPSILON)

    def kernel(self, key, channels_in, channels_out, norm=None):
        """Weight and bias of a 3x3 convolution, with the batch normalisation `norm` that follows it, if
        any, made part of them."""
        weight = self.weights.take(f"{key}.weight", (channels_out, channels_in, 3, 3))
        bias = self.weights.take(f"{key}.bias", (channels_out,))
        if norm is None:
            return weight, bias
        parts = self._norm_parts(norm, channels_out)
        gain = parts["weight"] / np.sqrt(parts["running_var"].astype(np.float64) + NORM_EPSILON)
        bias = (bias - parts["running_mean"].astype(np.float64)) * gain + parts["bias"]
        return (weight * gain[:, None, None, None]).astype(np.float32), bias.astype(np.float32)

    def instance_norm(self, x, channels):
        """Normalisation of every channel of every picture over its pixels, epsilon 1e-5, no weights."""
        one = self.constant(f"ones_{channels}", np.ones(channels, np.float32))
        zero = self.constant(f"zeros_{channels}", np.zeros(channels, np.float32))
        return self.node("InstanceNormalization", [x, one, zero], epsilon=1e-5)

    def relu(self, x):
        return self.node("Relu", [x])

    def sigmoid(self, x):
        return self.node("Sigmoid", [x])

    def tanh(self, x):
        return self.node("Tanh", [x])

    def concat(self, *tensors):
        """Joins along the channels."""
        return self.node("Concat", list(tensors), axis=1)

    def add(self, a, b):
        return self.node("Add", [a, b])

    def mul(self, a, b):
        return self.node("Mul", [a, b])

    def channels(self, x, first, end):
        """Channels `first..end`."""
        channel_axis = 1
        bounds = [
            self.constant(f"index_{n}", np.array([n], np.int64)) for n in (first, end, channel_axis)
        ]
        return self.node("Slice", [x, *bounds])

    def model(self):
        """The finished model, checked by ONNX' own rules."""
        graph = helper.make_graph(
            self.nodes, self.name, self.inputs, self.outputs, list(self.initializers.values())
        )
        model = helper.make_model(
            graph, opset_imports=[helper.make_opsetid("", OPSET)], ir_version=IR_VERSION,
            producer_name="plumbline",
        )
        onnx.checker.check_model(model, full_check=True)
        return model
