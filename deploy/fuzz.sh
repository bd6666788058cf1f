#!/usr/bin/env bash
# Searches for bytes that break what is read from outside: messages, lists, videos, settings, side-cars, flow
# files (fuzz/src). libFuzzer, on the stable toolchain and the tests' build: Plumbline's own crates are
# instrumented, with all checks on; libraries, FFmpeg among them, are run as they are.
# Usage: deploy/fuzz.sh [MINUTES [TARGET...]]     (default: 1 minute for each of all targets, one after another)
# What it finds lies in TARGET-DIRECTORY/fuzz/TARGET/found; put a small form of it into fuzz/corpus/TARGET, which the
# tests run through, and mend the code.
. "$(dirname "${BASH_SOURCE[0]}")/common.sh"

minutes=${1:-1}
shift || true
targets=("$@")
[ ${#targets[@]} -gt 0 ] || targets=($(ls fuzz/corpus))
setup_build
apt_install g++

work=${CARGO_TARGET_DIR:-$root/target}/fuzz
mkdir -p "$work"
say "building"
# What tells libFuzzer which branches were taken.
cat >"$work/instrumented" <<'RUSTC'
#!/bin/sh
exec "$@" -Cpasses=sancov-module -Cllvm-args=-sanitizer-coverage-level=4 \
    -Cllvm-args=-sanitizer-coverage-inline-8bit-counters -Cllvm-args=-sanitizer-coverage-pc-table \
    -Cllvm-args=-sanitizer-coverage-trace-compares
RUSTC
chmod +x "$work/instrumented"
RUSTC_WORKSPACE_WRAPPER=$work/instrumented \
    cargo build --locked --workspace --features plumbline-fuzz/libfuzzer --bin plumbline-fuzz
cp "${CARGO_TARGET_DIR:-$root/target}/debug/plumbline-fuzz" "$work/plumbline-fuzz"

# Files are written at every try: memory is the place for them.
[ ! -d /dev/shm ] || export TMPDIR=/dev/shm
found=0
for target in "${targets[@]}"; do
    say "$target: $minutes min"
    mkdir -p "$work/$target/corpus" "$work/$target/found"
    PLUMBLINE_FUZZ_TARGET=$target "$work/plumbline-fuzz" -max_total_time=$((minutes * 60)) \
        -max_len=65536 -timeout=60 -rss_limit_mb=2048 -malloc_limit_mb=1024 -print_final_stats=1 \
        -artifact_prefix="$work/$target/found/" "$work/$target/corpus" "fuzz/corpus/$target" \
        >"$work/$target/log" 2>&1 || { found=1; say "$target: a finding, see $work/$target/log"; }
    grep -E '^stat::number_of_executed_units|^Done' "$work/$target/log" >&2 || true
done
exit $found
