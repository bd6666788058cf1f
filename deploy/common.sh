# Sourced by the scripts beside it: what a fresh Debian or Ubuntu machine needs, installed once.
# Needs git and rustup's cargo; everything else is taken from apt.

set -euo pipefail
root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
cd "$root"

say() { printf '\n== %s\n' "$*" >&2; }

# apt_install PACKAGE... : installs what is missing, as root or through sudo.
apt_install() {
    local missing=()
    for package in "$@"; do
        dpkg-query -W -f='${Status}' "$package" 2>/dev/null | grep -q 'ok installed' || missing+=("$package")
    done
    [ ${#missing[@]} -eq 0 ] && return
    say "installing ${missing[*]}"
    local sudo=()
    [ "$(id -u)" -eq 0 ] || sudo=(sudo)
    "${sudo[@]}" apt-get update -qq
    "${sudo[@]}" env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends "${missing[@]}" >&2
}

# A free port of 127.0.0.1, below the range from which the kernel hands out its own.
free_port() {
    local port
    while :; do
        port=$((10000 + RANDOM % 20000))
        (exec 3<>"/dev/tcp/127.0.0.1/$port") 2>/dev/null || { echo "$port"; return; }
    done
}

need_cargo() {
    if ! command -v cargo >/dev/null; then
        [ -f "$HOME/.cargo/env" ] && . "$HOME/.cargo/env"
    fi
    if ! command -v cargo >/dev/null; then
        echo "cargo is missing: install Rust from https://rustup.rs and run this again" >&2
        exit 2
    fi
}

# What the build links against: FFmpeg's libraries, and libclang for their bindings.
setup_build() {
    need_cargo
    apt_install gcc libc6-dev pkg-config libclang-dev \
        libavcodec-dev libavformat-dev libavutil-dev libswscale-dev
}
