#!/usr/bin/env bash
# A private S3-compatible store below DIR: own port, credentials and data.
# Usage: deploy/store.sh DIR start|kill|stop
#   start   starts it (the first time on a free port, with one empty bucket) and waits until it answers;
#           DIR/env then exports PLUMBLINE_TEST_S3_ENDPOINT, PLUMBLINE_TEST_S3_BUCKET and the AWS_ variables
#   kill    ends it as a power cut would (SIGKILL)
#   stop    ends it
# PLUMBLINE_TEST_STORE chooses, at the first start, between
#   s3s-fs   (default) S3 over a directory; starts at once, checks signatures
#   garage   the server that people deploy; takes some minutes to build once. PLUMBLINE_TEST_GARAGE names a
#            built one
set -euo pipefail
[ $# -eq 2 ] || { echo "usage: deploy/store.sh DIR start|kill|stop" >&2; exit 2; }
dir=$(mkdir -p "$1" && cd "$1" && pwd)
action=$2
. "$(dirname "${BASH_SOURCE[0]}")/common.sh"

s3s_version=0.14.1
garage_version=2.5.0
cache=${XDG_CACHE_HOME:-$HOME/.cache}/plumbline
[ -f "$dir/kind" ] || echo "${PLUMBLINE_TEST_STORE:-s3s-fs}" >"$dir/kind"
kind=$(cat "$dir/kind")

# cargo_install CRATE VERSION ARG... : away from the workspace's target directory and its flags; prints the binary.
cargo_install() {
    local crate=$1 version=$2 root=$cache/$1-$2
    shift 2
    if [ ! -x "$root/bin/$crate" ]; then
        need_cargo
        say "installing $crate $version"
        (cd / && env -u CARGO_TARGET_DIR -u RUSTFLAGS cargo install --quiet --debug --locked --root "$root" \
            --version "$version" "$@" "$crate") >&2
    fi
    echo "$root/bin/$crate"
}

# The server's program; a failed build ends this script here.
case $kind:$action in
    s3s-fs:start) program=$(cargo_install s3s-fs "$s3s_version" --features binary) ;;
    garage:start)
        program=${PLUMBLINE_TEST_GARAGE:-}
        [ -n "$program" ] || program=$(cargo_install garage "$garage_version" --no-default-features --features bundled-libs,lmdb)
        ;;
    s3s-fs:* | garage:*) ;;
    *) echo "unknown store $kind: s3s-fs or garage" >&2; exit 2 ;;
esac

hex() { head -c "$1" /dev/urandom | od -An -tx1 | tr -d ' \n'; }

first_time() {
    local port=$1 key=plumbline secret=plumbline-secret region=us-east-1
    if [ "$kind" = garage ]; then
        key=GK$(hex 12) secret=$(hex 32) region=garage
        echo "$key" >"$dir/key"
        echo "$secret" >"$dir/secret"
        local rpc=127.0.0.1:$(free_port)
        cat >"$dir/garage.toml" <<-TOML
			metadata_dir = "$dir/meta"
			data_dir = "$dir/data"
			db_engine = "lmdb"
			replication_factor = 1
			rpc_bind_addr = "$rpc"
			rpc_public_addr = "$rpc"
			rpc_secret = "$(hex 32)"

			[s3_api]
			s3_region = "garage"
			api_bind_addr = "127.0.0.1:$port"
			root_domain = ".s3.localhost"
		TOML
    fi
    {
        echo "export PLUMBLINE_TEST_S3_ENDPOINT=http://127.0.0.1:$port PLUMBLINE_TEST_S3_BUCKET=plumbline"
        echo "export AWS_ACCESS_KEY_ID=$key AWS_SECRET_ACCESS_KEY=$secret AWS_REGION=$region"
    } >"$dir/env.new"
}

# launch PORT : starts it there; fails where it ends before it answers.
launch() {
    local port=$1 server
    case $kind in
        s3s-fs)
            mkdir -p "$dir/data/plumbline"
            server=("$program" --host 127.0.0.1 --port "$port" --access-key plumbline --secret-key plumbline-secret
                "$dir/data")
            ;;
        garage)
            server=(env GARAGE_CONFIG_FILE="$dir/garage.toml" GARAGE_DEFAULT_BUCKET=plumbline
                GARAGE_DEFAULT_ACCESS_KEY="$(cat "$dir/key")" GARAGE_DEFAULT_SECRET_KEY="$(cat "$dir/secret")"
                "$program" server --single-node --default-bucket)
            ;;
    esac
    RUST_LOG=warn setsid "${server[@]}" </dev/null >>"$dir/log" 2>&1 &
    echo $! >"$dir/pid"
    for _ in $(seq 300); do
        kill -0 "$(cat "$dir/pid")" 2>/dev/null || return 1
        (exec 3<>"/dev/tcp/127.0.0.1/$port") 2>/dev/null && return 0
        sleep 0.1
    done
    return 1
}

# end SIGNAL : ends it and waits until it is gone.
end() {
    [ -s "$dir/pid" ] || return 0
    local pid
    pid=$(cat "$dir/pid")
    kill "-$1" "$pid" 2>/dev/null || true
    for _ in $(seq 100); do
        kill -0 "$pid" 2>/dev/null || break
        sleep 0.1
    done
    kill -9 "$pid" 2>/dev/null || true
    rm -f "$dir/pid"
}

case $action in
    start)
        if [ -f "$dir/env" ]; then
            port=$(. "$dir/env" && echo "${PLUMBLINE_TEST_S3_ENDPOINT##*:}")
            # The port may be held for a moment by the connections of the one that was killed.
            for _ in $(seq 20); do launch "$port" && exit 0; sleep 0.5; done
        else
            # Another may take a free port before it is used.
            for _ in $(seq 20); do
                port=$(free_port)
                first_time "$port"
                launch "$port" && { mv "$dir/env.new" "$dir/env"; exit 0; }
            done
        fi
        echo "$kind does not start; its last words:" >&2
        tail -n 20 "$dir/log" >&2
        exit 1
        ;;
    kill) end KILL ;;
    stop) end TERM ;;
    *) echo "usage: deploy/store.sh DIR start|kill|stop" >&2; exit 2 ;;
esac
