#!/usr/bin/env bash
# Runs a command beside real servers: a RabbitMQ broker and an S3-compatible store, private to this run, on
# free ports of 127.0.0.1, gone with their data afterwards.
# Usage: deploy/servers.sh COMMAND [ARG...]
#
# The command finds in its environment
#   PLUMBLINE_TEST_AMQP_URL                                   the broker
#   PLUMBLINE_TEST_BROKER_DIR                                 its place, for deploy/broker.sh (restarts)
#   PLUMBLINE_TEST_S3_ENDPOINT, PLUMBLINE_TEST_S3_BUCKET      the store and an empty bucket
#   AWS_ACCESS_KEY_ID, AWS_SECRET_ACCESS_KEY, AWS_REGION      its credentials
# A server that the environment names already is used instead of starting one.
. "$(dirname "${BASH_SOURCE[0]}")/common.sh"

[ $# -gt 0 ] || { echo "usage: deploy/servers.sh COMMAND [ARG...]" >&2; exit 2; }
# A development server for S3 over a directory: starts at once, checks signatures.
s3s_version=0.14.1
cache=${XDG_CACHE_HOME:-$HOME/.cache}/plumbline/s3s-fs-$s3s_version
work=$(mktemp -d)
s3_pid=

stop() {
    [ -z "$s3_pid" ] || kill "$s3_pid" 2>/dev/null || true
    [ ! -d "$work/broker" ] || "$root/deploy/broker.sh" "$work/broker" stop
    rm -rf "$work"
}
trap stop EXIT
trap 'exit 130' INT
trap 'exit 143' TERM

if [ -z "${PLUMBLINE_TEST_AMQP_URL:-}" ]; then
    apt_install rabbitmq-server
    say "starting RabbitMQ"
    PLUMBLINE_TEST_BROKER_DIR=$work/broker
    "$root/deploy/broker.sh" "$PLUMBLINE_TEST_BROKER_DIR" start
    PLUMBLINE_TEST_AMQP_URL=$(cat "$PLUMBLINE_TEST_BROKER_DIR/url")
    export PLUMBLINE_TEST_AMQP_URL PLUMBLINE_TEST_BROKER_DIR
fi

if [ -z "${PLUMBLINE_TEST_S3_ENDPOINT:-}" ]; then
    if [ ! -x "$cache/bin/s3s-fs" ]; then
        need_cargo
        say "installing s3s-fs $s3s_version"
        # Away from the workspace's target directory and its flags.
        (cd / && env -u CARGO_TARGET_DIR -u RUSTFLAGS cargo install --quiet --debug --locked --root "$cache" \
            --version "$s3s_version" --features binary s3s-fs)
    fi
    export AWS_ACCESS_KEY_ID=plumbline AWS_SECRET_ACCESS_KEY=plumbline-secret AWS_REGION=us-east-1
    export PLUMBLINE_TEST_S3_BUCKET=plumbline
    mkdir -p "$work/s3/$PLUMBLINE_TEST_S3_BUCKET"
    for _ in $(seq 20); do
        port=$(free_port)
        RUST_LOG=warn "$cache/bin/s3s-fs" --host 127.0.0.1 --port "$port" --access-key "$AWS_ACCESS_KEY_ID" \
            --secret-key "$AWS_SECRET_ACCESS_KEY" "$work/s3" </dev/null >"$work/s3.log" 2>&1 &
        s3_pid=$!
        for _ in $(seq 100); do
            kill -0 "$s3_pid" 2>/dev/null || break # another took the port meanwhile
            if (exec 3<>"/dev/tcp/127.0.0.1/$port") 2>/dev/null; then
                PLUMBLINE_TEST_S3_ENDPOINT=http://127.0.0.1:$port
                break 2
            fi
            sleep 0.1
        done
    done
    [ -n "${PLUMBLINE_TEST_S3_ENDPOINT:-}" ] || { echo "s3s-fs does not start:" >&2; cat "$work/s3.log" >&2; exit 1; }
    export PLUMBLINE_TEST_S3_ENDPOINT
fi

"$@"
