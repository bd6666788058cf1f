#!/usr/bin/env bash
# Holds all dependencies against deny.toml: licences, banned crates, sources, and known advisories where their
# database can be reached (it is a git repository, not a package). Apart from test.sh, since cargo-deny itself takes
# minutes to build.
. "$(dirname "${BASH_SOURCE[0]}")/common.sh"

version=0.20.2
need_cargo
deny=${XDG_CACHE_HOME:-$HOME/.cache}/plumbline/cargo-deny-$version/bin/cargo-deny
if [ ! -x "$deny" ]; then
    say "installing cargo-deny $version"
    (cd / && env -u CARGO_TARGET_DIR -u RUSTFLAGS cargo install --quiet --debug --locked \
        --root "${deny%/bin/*}" --version "$version" cargo-deny)
fi
"$deny" --locked check licenses bans sources
say "advisories"
if ! git ls-remote --quiet https://github.com/RustSec/advisory-db HEAD >/dev/null 2>&1; then
    say "not checked: the advisory database cannot be reached from here"
    exit
fi
"$deny" --locked check advisories
