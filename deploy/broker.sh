#!/usr/bin/env bash
# A private RabbitMQ node below DIR: own name, ports, cookie, data and port mapper; nothing of the system's
# broker is touched.
# Usage: deploy/broker.sh DIR start|kill|stop|ctl ARG...
#   start   starts it (the first time on free ports) and waits until it answers; DIR/url is its address
#   kill    ends it as a power cut would (SIGKILL)
#   stop    ends it and its port mapper
#   ctl     rabbitmqctl against it
set -euo pipefail
[ $# -ge 2 ] || { echo "usage: deploy/broker.sh DIR start|kill|stop|ctl ARG..." >&2; exit 2; }
dir=$(mkdir -p "$1" && cd "$1" && pwd)
shift
. "$(dirname "${BASH_SOURCE[0]}")/common.sh"
sbin=$(ls -d /usr/lib/rabbitmq/lib/rabbitmq_server-*/sbin 2>/dev/null | tail -n 1)
[ -n "$sbin" ] || { echo "RabbitMQ is missing: apt-get install rabbitmq-server" >&2; exit 2; }
deadline_s=120

if [ ! -f "$dir/env" ]; then
    mkdir -p "$dir/home" "$dir/data" "$dir/log"
    head -c 32 /dev/urandom | od -An -tx1 | tr -d ' \n' >"$dir/home/.erlang.cookie"
    chmod 400 "$dir/home/.erlang.cookie"
    echo '[].' >"$dir/plugins"
    # Small logs of the replicated queues, and no alarm on a nearly full disk.
    printf '%s\n' 'raft.wal_max_size_bytes = 67108864' 'disk_free_limit.absolute = 50MB' >"$dir/rabbitmq.conf"
    amqp_port=$(free_port)
    {
        echo "export HOME='$dir/home'"
        echo "export RABBITMQ_NODENAME=plumbline-$amqp_port@localhost"
        echo "export RABBITMQ_NODE_IP_ADDRESS=127.0.0.1 RABBITMQ_NODE_PORT=$amqp_port"
        echo "export RABBITMQ_DIST_PORT=$(free_port) ERL_EPMD_PORT=$(free_port) ERL_EPMD_ADDRESS=127.0.0.1"
        echo "export RABBITMQ_MNESIA_BASE='$dir/data' RABBITMQ_LOG_BASE='$dir/log' RABBITMQ_PID_FILE='$dir/pid'"
        echo "export RABBITMQ_ENABLED_PLUGINS_FILE='$dir/plugins' RABBITMQ_CONFIG_FILE='$dir/rabbitmq.conf'"
        echo "export RABBITMQ_CONF_ENV_FILE=/dev/null"
    } >"$dir/env"
    echo "amqp://guest:guest@127.0.0.1:$amqp_port/%2f" >"$dir/url"
fi
. "$dir/env"

# alive FILE : whether the process whose id FILE holds runs.
alive() { [ -s "$1" ] && kill -0 "$(cat "$1")" 2>/dev/null; }

# end SIGNAL FILE : ends the process whose id FILE holds, and waits for it.
end() {
    alive "$2" || return 0
    local pid
    pid=$(cat "$2")
    kill "-$1" "$pid"
    for _ in $(seq 300); do
        kill -0 "$pid" 2>/dev/null || { rm -f "$2"; return 0; }
        sleep 0.1
    done
    kill -9 "$pid"
    rm -f "$2"
}

case $1 in
    start)
        # Erlang would leave its port mapper behind as a daemon: run it where its process id is known.
        if ! alive "$dir/epmd.pid"; then
            epmd -port "$ERL_EPMD_PORT" -address 127.0.0.1 </dev/null >"$dir/log/epmd" 2>&1 &
            echo $! >"$dir/epmd.pid"
        fi
        rm -f "$dir/pid"
        setsid "$sbin/rabbitmq-server" </dev/null >"$dir/log/console" 2>&1 &
        started=$!
        for _ in $(seq $((deadline_s * 5))); do
            if (exec 3<>"/dev/tcp/127.0.0.1/$RABBITMQ_NODE_PORT") 2>/dev/null; then
                exit 0
            fi
            kill -0 "$started" 2>/dev/null || break
            sleep 0.2
        done
        echo "RabbitMQ does not answer on port $RABBITMQ_NODE_PORT; its last words:" >&2
        tail -n 20 "$dir/log/console" >&2
        exit 1
        ;;
    kill) end KILL "$dir/pid" ;;
    stop) end TERM "$dir/pid"; end TERM "$dir/epmd.pid" ;;
    ctl) shift; exec "$sbin/rabbitmqctl" "$@" ;;
    *) echo "usage: deploy/broker.sh DIR start|kill|stop|ctl ARG..." >&2; exit 2 ;;
esac
