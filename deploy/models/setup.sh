#!/usr/bin/env bash
# Makes the Python environment of the converter, and with it ONNX Runtime's shared library.
# Usage: deploy/models/setup.sh [DIR]     DIR: target/models-venv unless given
# Prints the path of the library, which is also kept as DIR/libonnxruntime.so. About 230 MB; no PyTorch.
. "$(dirname "${BASH_SOURCE[0]}")/../common.sh"

venv=${1:-${CARGO_TARGET_DIR:-$root/target}/models-venv}
requirements=$root/deploy/models/requirements.txt
if ! cmp -s "$requirements" "$venv/installed.txt"; then
    if ! "$venv/bin/python" -m pip --version >/dev/null 2>&1; then
        python3 -c 'import ensurepip, venv' 2>/dev/null || apt_install python3 python3-venv
        python3 -m venv "$venv"
    fi
    say "installing the model converter"
    "$venv/bin/python" -m pip install --quiet --disable-pip-version-check --only-binary :all: -r "$requirements" >&2
    library=$("$venv/bin/python" -c '
import importlib.util, pathlib
package = pathlib.Path(importlib.util.find_spec("onnxruntime").origin).parent
(library,) = (package / "capi").glob("libonnxruntime.so.*")
print(library)')
    ln -sfn "$library" "$venv/libonnxruntime.so"
    cp "$requirements" "$venv/installed.txt"
fi
echo "$venv/libonnxruntime.so"
