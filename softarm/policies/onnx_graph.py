"""Check of the operators in an ONNX file, before any of it runs.

An ONNX model is a protobuf message (onnx.proto3): fields of a number and a wire type. Only the operators are read here;
onnxruntime checks the graph itself.
"""

from collections.abc import Iterator

SIZE_MAX = 64 * 1024 * 1024  # bytes; a shipped policy has 1.6 million
NODES_MAX = 1000  # a shipped policy has 16
# Operators of policies. None of them loops, runs a subgraph, reads a file or draws random numbers.
_NAMES = (
    "Abs Add Cast Clip Concat Constant Cos Div Dropout Elu Erf Exp Flatten Gather Gelu Gemm GRU HardSigmoid "
    "Identity LayerNormalization LeakyRelu Log LSTM MatMul Max Min Mul Neg Pow ReduceMean Relu Reshape RNN "
    "Selu Shape Sigmoid Sin Slice Softmax Softplus Split Sqrt Squeeze Sub Tanh Transpose Unsqueeze "
)
OPERATORS = frozenset(_NAMES.split())
_GRAPH, _FUNCTIONS, _NODE, _OPERATOR, _DOMAIN = 7, 25, 1, 4, 7  # ModelProto's, GraphProto's, NodeProto's
_BYTES = 2


class GraphError(Exception):
    """A rejected file; the text states why."""


def check_size(size: int) -> None:
    """Check the size of a file in bytes. Raises GraphError if it is too large."""
    if size > SIZE_MAX:
        raise GraphError(f"it has {size / 1e6:.0f} MB; allowed are {SIZE_MAX / 1e6:.0f}")


def check(content: bytes) -> None:
    """Check a model. Raises GraphError if it is too large or uses operators that no policy needs."""
    check_size(len(content))
    found = list(operators(memoryview(content)))
    if len(found) > NODES_MAX:
        raise GraphError(f"its graph has {len(found)} nodes; allowed are {NODES_MAX}")
    if foreign := sorted(set(found) - OPERATORS):
        raise GraphError(
            f"its graph holds {', '.join(foreign[:5])}, which no policy needs; allowed: see docs/policies/interface.md"
        )


def operators(model: memoryview) -> Iterator[str]:
    """Yield the operator of every node, with its domain unless it is ONNX's, and an entry per custom function."""
    for number, value in _fields(model):
        if number == _FUNCTIONS:
            yield "a custom function"
        elif number == _GRAPH:
            yield from (_operator(node) for field, node in _fields(value) if field == _NODE)


def _operator(node: memoryview) -> str:
    texts = {field: bytes(value).decode("utf-8", "replace") for field, value in _fields(node)}
    domain, name = texts.get(_DOMAIN, ""), texts.get(_OPERATOR, "")
    return name if domain in ("", "ai.onnx") else f"{domain}.{name}"


def _fields(message: memoryview) -> Iterator[tuple[int, memoryview]]:
    """Yield the fields of a message that hold bytes (texts and messages). Raises GraphError for invalid data."""
    at = 0
    while at < len(message):
        key, at = _number(message, at)
        kind = key & 7
        if kind == _BYTES:
            size, at = _number(message, at)
            if at + size > len(message):
                raise GraphError("it is cut short")
            yield key >> 3, message[at : at + size]
            at += size
        elif kind == 0:
            _, at = _number(message, at)
        elif kind in (1, 5):
            at += 8 if kind == 1 else 4
        else:
            raise GraphError("it is not a protobuf message")


def _number(message: memoryview, at: int) -> tuple[int, int]:
    """Return a varint and the position after it."""
    value = 0
    for shift in range(0, 70, 7):
        if at >= len(message):
            raise GraphError("it is cut short")
        byte = message[at]
        at += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, at
    raise GraphError("it is not a protobuf message")
