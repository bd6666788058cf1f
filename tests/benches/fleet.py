"""The measurements of fleet.sh; prints the results as Markdown. Standard library only.

    fleet.py WORK COMMIT

Rates are taken between the first and the last row in the coordinator's journal, so that neither listing nor
publishing the scores counts; the whole command stands beside them.
"""

import json
import os
import subprocess
import sys
import time
from pathlib import Path

WORK, COMMIT = Path(sys.argv[1]), sys.argv[2]
ENV = dict(os.environ)
PLUMBLINE, WORKER, CELERY = ENV["PLUMBLINE"], ENV["WORKER"], ENV["CELERY"]
URL = ENV["PLUMBLINE_TEST_AMQP_URL"]
BUCKET = ENV["PLUMBLINE_TEST_S3_BUCKET"]
STORE = Path(ENV["PLUMBLINE_TEST_STORE_DIR"], "data", BUCKET)
BROKER_PID = int(Path(ENV["PLUMBLINE_TEST_BROKER_DIR"], "pid").read_text())
ENV["AWS_ENDPOINT_URL"] = ENV["PLUMBLINE_TEST_S3_ENDPOINT"]
for name in list(ENV):
    if name.startswith("PLUMBLINE_"):
        del ENV[name]
HERE = Path(__file__).parent
TICKS_PER_S = os.sysconf("SC_CLK_TCK")

NOOP_JOBS = 30_000
NOOP_SLOTS = 64
CELERY_JOBS = 3_000
BUSY_MS, BUSY_JOBS, BUSY_SLOTS = 50, 2_000, 8
CLIP_COPIES = 3
REPEATS = 3


def say(text):
    print(text, file=sys.stderr, flush=True)


def cpu_s(pid):
    """CPU seconds of a process and the children it has waited for."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    except OSError:
        return 0.0
    return sum(int(field) for field in fields[11:15]) / TICKS_PER_S


class Workers:
    """Workers at work, for a `with`."""

    def __init__(self, count, *words):
        self.count, self.words = count, words

    def __enter__(self):
        self.processes = []
        for index in range(self.count):
            scratch = WORK / f"scratch-{index}"
            scratch.mkdir(exist_ok=True)
            log = open(WORK / f"worker-{index}.log", "ab")
            command = [WORKER, "--queue", URL, "--name", f"w{index}", "--scratch", scratch]
            self.processes.append(subprocess.Popen([*command, *self.words], env=ENV, stdout=log, stderr=log))
        time.sleep(2)
        for process in self.processes:
            if process.poll() is not None:
                raise SystemExit(f"a worker does not run: see {WORK}\n" + (WORK / "worker-0.log").read_text()[-2000:])
        return self

    def cpu_s(self):
        return sum(cpu_s(process.pid) for process in self.processes)

    def __exit__(self, *_):
        for process in self.processes:
            process.terminate()
        for process in self.processes:
            process.wait(60)


RUNS = iter(range(1_000_000))


def score(prefix, workers, *words):
    """One run; rows, seconds from the first to the last row, and CPU seconds meanwhile."""
    run = f"bench-{os.getpid()}-{next(RUNS)}"
    out = WORK / run
    journal = out / ".plumbline" / "journal"
    command = [PLUMBLINE, "score", f"s3://{BUCKET}/{prefix}/", "--out", out, "--queue", URL, "--run", run, *words]
    log = open(WORK / f"{run}.log", "wb")
    before = (workers.cpu_s(), cpu_s(BROKER_PID))
    started = time.monotonic()
    process = subprocess.Popen([*command, "--format", "jsonl"], env=ENV, stdout=log, stderr=log)
    first = last = None
    size = 0
    coordinator_s = 0.0
    while process.poll() is None:
        now = time.monotonic()
        grown = journal.stat().st_size if journal.exists() else 0
        if grown > size:
            first, last, size = first or now, now, grown
            after = (workers.cpu_s(), cpu_s(BROKER_PID))
            coordinator_s = cpu_s(process.pid)
        time.sleep(0.005)
    whole = time.monotonic() - started
    if process.returncode not in (0, 3):
        raise SystemExit(f"score failed: {Path(log.name).read_text()[-3000:]}")
    rows = len((out / "scores.jsonl").read_text().splitlines())
    return {
        "rows": rows,
        "phase_s": last - first,
        "per_s": (rows - 1) / (last - first),
        "whole_s": whole,
        "coordinator_s": coordinator_s,
        "worker_s": after[0] - before[0],
        "broker_s": after[1] - before[1],
    }


def files(prefix, count):
    """Objects that no-op jobs name; a store over a directory takes them from there."""
    place = STORE / prefix
    place.mkdir(parents=True)
    for index in range(count):
        (place / f"{index:06}.mp4").write_bytes(b"-")


def clips():
    """The rendered sample, each clip several times under names of its own and with bytes of its own."""
    subprocess.run([PLUMBLINE, "sample", "--out", WORK / "sample", "--no-dense-truth"], check=True, env=ENV,
                   stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    place = STORE / "clips"
    place.mkdir(parents=True)
    count = 0
    for clip in sorted((WORK / "sample" / "videos").glob("*.mp4")):
        for copy in range(CLIP_COPIES):
            # A box that players skip, so that no two objects are the same.
            box = (16).to_bytes(4, "big") + b"free" + copy.to_bytes(8, "big")
            (place / f"{clip.stem}-{copy}.mp4").write_bytes(clip.read_bytes() + box)
            count += 1
    return count


def celery(processes, pool, drivers):
    """Jobs per second of Celery, publishing to collecting, by so many programs at once: one waits for every
    confirmation before it publishes the next."""
    env = dict(ENV, FLEET_AMQP_URL=URL, FLEET_PREFETCH=str(NOOP_SLOTS), FLEET_PROCESSES=str(processes),
               PYTHONPATH=str(HERE), PYTHONDONTWRITEBYTECODE="1")
    log = open(WORK / "celery.log", "ab")
    command = [f"{CELERY}/celery", "-A", "fleet_celery", "worker", "--pool", pool, "--concurrency", str(processes),
               "--without-gossip", "--without-mingle", "--without-heartbeat", "--loglevel", "WARNING"]
    worker = subprocess.Popen(command, env=env, cwd=WORK, stdout=log, stderr=log)
    try:
        env["FLEET_START_S"] = str(time.monotonic() + 5)
        driver = [f"{CELERY}/python", HERE / "fleet_celery.py", str(CELERY_JOBS // drivers)]
        running = [
            subprocess.Popen(driver, env=env, cwd=WORK, stdout=subprocess.PIPE, stderr=log) for _ in range(drivers)
        ]
        told = [process.communicate(timeout=300)[0] for process in running]
        if any(process.returncode for process in running):
            raise SystemExit(f"celery: {(WORK / 'celery.log').read_text()[-2000:]}")
        runs = [json.loads(text) for text in told]
        started = min(run["started_s"] for run in runs)
        all_s = max(run["collected_s"] for run in runs) - started
        jobs = sum(run["jobs"] for run in runs)
        return {
            "what": f"{pool}, {processes} processes, {drivers} publishers",
            "jobs": jobs,
            "publish_s": max(run["published_s"] for run in runs) - started,
            "all_s": all_s,
            "jobs_per_s": jobs / all_s,
        }
    finally:
        worker.terminate()
        worker.wait(60)


def main():
    say("objects")
    files("noop", NOOP_JOBS)
    files("busy", BUSY_JOBS)
    clip_count = clips()

    ours, theirs = [], []
    for repeat in range(REPEATS):
        say(f"no-op jobs, {repeat + 1} of {REPEATS}")
        with Workers(1, "--slots", str(NOOP_SLOTS), "--no-op") as workers:
            ours.append(score("noop", workers))
        say(f"Celery, {repeat + 1} of {REPEATS}")
        theirs += [celery(2, "prefork", 1), celery(2, "prefork", 4)]
    theirs.append(celery(1, "solo", 4))

    say(f"jobs of {BUSY_MS} ms")
    with Workers(1, "--slots", str(BUSY_SLOTS), "--no-op", "--no-op-ms", str(BUSY_MS)) as workers:
        busy = score("busy", workers)

    real = {1: [], 2: []}
    for repeat in range(2):
        for count in real:
            say(f"{count} workers on clips, {repeat + 1} of 2")
            with Workers(count, "--slots", "1") as workers:
                real[count].append(score("clips", workers, "--profile", "standard"))

    report(ours, theirs, busy, real, clip_count)


def median(values):
    return sorted(values)[len(values) // 2]


def report(ours, theirs, busy, real, clip_count):
    model = next((line.split(":")[1].strip() for line in open("/proc/cpuinfo") if line.startswith("model name")), "?")
    rate = median([run["per_s"] for run in ours])
    best_peer = max(run["jobs_per_s"] for run in theirs)
    print(f"# What a fleet costs beside its work: {time.strftime('%F')}\n")
    print(f"- machine: {model}, {os.cpu_count()} cores, Linux x86-64, load {os.getloadavg()[0]:.2f}; broker, store, coordinator and workers all on it")
    print(f"- commit {COMMIT}; RabbitMQ {rabbit_version()}, Celery {celery_version()}")
    print("- command: `tests/benches/fleet.sh`\n")
    print(f"## No-op jobs: `score` publishes, `plumbline-worker --no-op --slots {NOOP_SLOTS}` works, `score` collects\n")
    print("Quorum queues, persistent messages, publisher confirms for jobs and results, jobs and results settled late.\n")
    print("| run | jobs | jobs/s, first to last row | jobs/s, whole command | CPU s: coordinator | worker | broker |")
    print("|---|---|---|---|---|---|---|")
    for index, run in enumerate(ours, 1):
        print(f"| {index} | {run['rows']} | {run['per_s']:.0f} | {run['rows'] / run['whole_s']:.0f} | {run['coordinator_s']:.1f} | {run['worker_s']:.1f} | {run['broker_s']:.1f} |")
    print("\n| Celery, same broker, quorum queue, confirms, `acks_late`, prefetch "
          f"{NOOP_SLOTS} | jobs | publish s | all s | jobs/s |")
    print("|---|---|---|---|---|")
    for run in theirs:
        print(f"| {run['what']} | {run['jobs']} | {run['publish_s']:.1f} | {run['all_s']:.1f} | {run['jobs_per_s']:.0f} |")
    print(f"\nOur median {rate:.0f} against Celery's best {best_peer:.0f} jobs/s: {rate / best_peer:.1f} times.\n")
    print(f"## Slots with jobs of {BUSY_MS} ms\n")
    used = (busy["rows"] - 1) * BUSY_MS / 1000 / (BUSY_SLOTS * busy["phase_s"])
    print(f"{busy['rows']} jobs on {BUSY_SLOTS} slots in {busy['phase_s']:.1f} s: slots work {100 * used:.1f}% of the time.\n")
    print(f"## One worker and two (one slot each) on {clip_count} rendered clips at `standard`\n")
    print("| workers | clips/s, first to last row | whole command s |")
    print("|---|---|---|")
    for count, runs in real.items():
        for run in runs:
            print(f"| {count} | {run['per_s']:.2f} | {run['whole_s']:.1f} |")
    one, two = (max(run["per_s"] for run in real[count]) for count in (1, 2))
    print(f"\nTwo workers: {two / one:.2f} times one (the better run of each).")


def rabbit_version():
    out = subprocess.run(["dpkg-query", "-W", "-f=${Version}", "rabbitmq-server"], capture_output=True, text=True)
    return out.stdout.split("-")[0] or "?"


def celery_version():
    out = subprocess.run([f"{CELERY}/celery", "--version"], capture_output=True, text=True)
    return out.stdout.split()[0]


main()
