#!/usr/bin/env bash
# Runs a command beside real servers: a RabbitMQ broker and an S3-compatible store, private to this run, on
# free ports of 127.0.0.1, gone with their data afterwards.
# Usage: deploy/servers.sh COMMAND [ARG...]
#
# The command finds in its environment
#   PLUMBLINE_TEST_AMQP_URL                                   the broker
#   PLUMBLINE_TEST_BROKER_DIR                                 its place, for deploy/broker.sh (restarts)
#   PLUMBLINE_TEST_S3_ENDPOINT, PLUMBLINE_TEST_S3_BUCKET      the store and an empty bucket
#   PLUMBLINE_TEST_STORE_DIR                                  its place, for deploy/store.sh (restarts)
#   AWS_ACCESS_KEY_ID, AWS_SECRET_ACCESS_KEY, AWS_REGION      its credentials
# A server that the environment names already is used instead of starting one. PLUMBLINE_TEST_STORE=garage
# chooses another store than s3s-fs (deploy/store.sh).
. "$(dirname "${BASH_SOURCE[0]}")/common.sh"

[ $# -gt 0 ] || { echo "usage: deploy/servers.sh COMMAND [ARG...]" >&2; exit 2; }
work=$(mktemp -d)

stop() {
    [ ! -d "$work/store" ] || "$root/deploy/store.sh" "$work/store" stop
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
    say "starting the object store"
    PLUMBLINE_TEST_STORE_DIR=$work/store
    "$root/deploy/store.sh" "$PLUMBLINE_TEST_STORE_DIR" start
    . "$PLUMBLINE_TEST_STORE_DIR/env"
    export PLUMBLINE_TEST_STORE_DIR
fi

"$@"
