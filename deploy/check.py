"""What the files of a deployment promise each other, and the programs: run by check.sh."""

import json
import pathlib
import re
import sys

import yaml

deploy = pathlib.Path(__file__).parent
problems = []


def must(promise, holds):
    if not holds:
        problems.append(promise)


def seconds(text):
    """A time as Compose writes it, of seconds only."""
    return int(text.removesuffix("s"))


def mib(text):
    """A size as Kubernetes and Compose write it."""
    number, unit = re.fullmatch(r"([0-9]+)(Gi|Mi|g|m)", text).groups()
    return int(number) * (1024 if unit in ("Gi", "g") else 1)


def options(arguments):
    """Options of a command line, both as `--name=value` and as `--name value`."""
    words = [word for argument in arguments for word in argument.split("=", 1)]
    return {name[2:]: value for name, value in zip(words, words[1:]) if name.startswith("--")}


# A job may take a fetch and two processes, each as long as the deadline allows (worker/src/cli.rs).
consumer_timeout_s = int(re.search(r"^consumer_timeout = (\d+)", (deploy / "rabbitmq.conf").read_text(), re.M)[1]) / 1000
slot = (deploy.parent / "worker/src/child/slot.rs").read_text()
learned_deadline_s = float(re.search(r"learned_deadline_s: ([0-9_.]+),", slot)[1].replace("_", ""))
must("the broker waits longer than a job of learned networks may take", consumer_timeout_s > 3 * learned_deadline_s)

worker = yaml.safe_load((deploy / "kubernetes/worker.yaml").read_text())
pod = worker["spec"]["template"]["spec"]
container = pod["containers"][0]
given = options(container["args"])
must("a pod gets longer than --grace and the 5 s of handing back", pod["terminationGracePeriodSeconds"] > int(given["grace"]) + 5)
must("the broker waits longer than a job may take", consumer_timeout_s > 3 * float(given["deadline"]))
must(
    "a pod may use more memory than its slots",
    mib(container["resources"]["limits"]["memory"]) > int(given["slots"]) * int(given["memory"]),
)
port = container["ports"][0]["containerPort"]
must("a pod's port is what it listens on", given["listen"].endswith(f":{port}"))
for probe, path in (("startupProbe", "/healthz"), ("livenessProbe", "/healthz"), ("readinessProbe", "/readyz")):
    must(f"{probe} asks {path}", container[probe]["httpGet"]["path"] == path)

compose = yaml.safe_load((deploy / "compose.yaml").read_text())
service = compose["services"]["worker"]
given = options(service["command"])
must("a container gets longer than --grace", seconds(service["stop_grace_period"]) > int(given["grace"]) + 5)
must(
    "a container may use more memory than its slots",
    mib(service["deploy"]["resources"]["limits"]["memory"]) > int(given["slots"]) * int(given["memory"]),
)

scaled = next(yaml.safe_load_all((deploy / "kubernetes/scaling.yaml").read_text()))
trigger = scaled["spec"]["triggers"][0]["metadata"]
must("unsettled jobs are counted, which only the management API does", trigger["protocol"] == "http")
must("what is scaled is the worker", scaled["spec"]["scaleTargetRef"]["name"] == worker["metadata"]["name"])

dashboard = json.loads((deploy / "grafana/plumbline.json").read_text())
ids = [panel["id"] for panel in dashboard["panels"]]
must("panels have ids of their own", len(ids) == len(set(ids)))

for problem in problems:
    print(f"deploy: it does not hold that {problem}", file=sys.stderr)
sys.exit(1 if problems else 0)
