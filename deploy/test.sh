#!/usr/bin/env bash
# Sets up and runs the tests.
# Usage: deploy/test.sh [SUITE]
#   unit      formatting, lints, documentation, the deployment's files, and the tests beside the code
#   cli       end-to-end tests of the built command
#   browser   the report in a headless Chromium, which it installs
#   parity    numbers of the reference implementations
#   numerics  flow, geometry and statistics, with their extremes
#   fleet     queues, object stores and a fleet under faults, against real servers, which it installs and starts
# Without a name: all of them.
. "$(dirname "${BASH_SOURCE[0]}")/common.sh"

suite=${1:-all}
# Property tests draw the same cases on every run; set another seed to look for more.
export PROPTEST_RNG_SEED=${PROPTEST_RNG_SEED:-20261123}
setup_build
if ! cargo nextest --version >/dev/null 2>&1; then
    say "installing cargo-nextest"
    cargo install --locked cargo-nextest
fi

lint() {
    say "formatting, lints, documentation"
    cargo fmt --all --check
    cargo clippy --locked --workspace --all-targets -- -D warnings
    RUSTDOCFLAGS="-D warnings" cargo doc --locked --workspace --no-deps --document-private-items --quiet
    deploy/check.sh
}

# run FILTER [WRAPPER]: the tests that a nextest filter names; the command under test is built first.
run() {
    say "tests: $1"
    cargo build --locked --bin plumbline --bin plumbline-worker
    ${2:-} cargo nextest run --locked --workspace --no-fail-fast -E "$1"
}

# What the Python prototype finds on ten clips, where prototype and clips are at hand; made anew when one
# of its inputs is newer.
export_prototype() {
    local shared=$root/../shared work=${CARGO_TARGET_DIR:-$root/target}/tmp
    local out=$work/prototype venv=$work/prototype-venv
    [ -d "$shared/prototype" ] && [ -d "$shared/data/rollouts" ] || return 0
    [ ! -f "$out/done" ] || [ -n "$(find tests/parity "$shared/prototype" -type f -newer "$out/done")" ] || return 0
    say "running the Python prototype on ten clips"
    if ! "$venv/bin/python" -c 'import cv2' 2>/dev/null; then
        apt_install python3-venv
        python3 -m venv "$venv"
    fi
    "$venv/bin/pip" install --quiet --disable-pip-version-check -r tests/parity/requirements.txt
    rm -f "$out/done"
    "$venv/bin/python" -B tests/parity/export_prototype.py clips "$shared/prototype" "$shared/data/rollouts" "$out"
    touch "$out/done"
}

# Small model sets of random weights, for the tests of the command; made anew when the converter is newer.
seed_models() {
    local work=${CARGO_TARGET_DIR:-$root/target}/tmp
    deploy/models/setup.sh "$work/models-venv" >/dev/null
    [ -z "$(find deploy/models -name '*.py' -newer "$work/models/done" 2>&1)" ] && return
    say "converting models of random weights"
    rm -rf "$work/models"
    mkdir -p "$work/models"
    local network name python="$work/models-venv/bin/python -B"
    for network in sea-raft droid; do
        name=${network/raft/raft-small}
        $python deploy/models/seeded.py "$name" "$work/$name.safetensors"
        $python deploy/models/convert.py "$network" "$work/$name.safetensors" --out "$work/models/$name" >/dev/null
        rm "$work/$name.safetensors"
    done
    touch "$work/models/done"
}

# The library by which trainers read shards, with which the tests read what was kept of them.
install_trainers() {
    local venv=${CARGO_TARGET_DIR:-$root/target}/tmp/trainers-venv
    if ! "$venv/bin/python" -c '' 2>/dev/null; then
        apt_install python3-venv
        python3 -m venv "$venv"
    fi
    "$venv/bin/pip" install --quiet --disable-pip-version-check -r tests/trainers/requirements.txt
}

# The model converter's own tests, its networks against the reference's numbers where those are at hand, and
# the converted sets for the tests in Rust.
convert_models() {
    local golden=$root/../shared/golden work=${CARGO_TARGET_DIR:-$root/target}/tmp
    deploy/models/setup.sh "$work/models-venv" >/dev/null
    local python="$work/models-venv/bin/python -B"
    say "tests: the model converter"
    if [ ! -f "$golden/droid_nets.npz" ]; then
        (cd deploy/models && $python -m unittest test_converter test_winograd)
        return
    fi
    (cd deploy/models && PLUMBLINE_GOLDEN=$golden $python -m unittest test_converter test_winograd)
    rm -rf "$work/learned"
    $python deploy/models/parity.py "$golden" --out "$work/learned"
}

cli='package(plumbline-tests) and not binary(/^(browser|campaign|fleet)$/)'
browser='binary(browser)'
parity='binary(/^parity/)'
fleet='(package(plumbline-common) and binary(/^(queue|store|restart)$/)) or binary(/^(campaign|fleet)$/)'
servers=deploy/servers.sh
numerics="(package(plumbline-vision) or test(/^reduce::/)) and not ($parity)"
case $suite in
    unit) lint; run "not ($cli) and not ($browser) and not ($parity) and not ($numerics) and not ($fleet)" ;;
    cli) install_trainers; seed_models; run "$cli" ;;
    browser) apt_install chromium chromium-driver; run "$browser" ;;
    parity) export_prototype; convert_models; run "$parity" ;;
    numerics) run "$numerics" ;;
    fleet) seed_models; run "$fleet" "$servers" ;;
    all) apt_install chromium chromium-driver; lint; export_prototype; convert_models; seed_models; install_trainers; run 'all()' "$servers" ;;
    *) echo "unknown suite $suite: unit, cli, browser, parity, numerics or fleet" >&2; exit 2 ;;
esac
