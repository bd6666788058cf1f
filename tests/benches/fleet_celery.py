"""The same no-op job for Celery, with the guarantees of ours: quorum queue, publisher confirms, persistent
messages, acknowledged after the work, results sent back and collected.

    celery -A fleet_celery worker ...        works
    python fleet_celery.py JOBS              publishes, collects, prints when as JSON (seconds of the
                                             machine's monotonic clock, the same in all processes)
"""

import json
import os
import sys
import time

from celery import Celery
from celery.result import ResultSet

# The prefetch of both sides: that many jobs at most are unsettled.
PREFETCH = int(os.environ.get("FLEET_PREFETCH", "64"))
PROCESSES = int(os.environ.get("FLEET_PROCESSES", "2"))

app = Celery("fleet_celery", broker=os.environ["FLEET_AMQP_URL"].replace("%2f", "/"), backend="rpc://")
app.conf.update(
    task_default_queue="celery_noop",
    task_default_queue_type=os.environ.get("FLEET_QUEUE_TYPE", "quorum"),
    task_default_exchange_type="direct",
    broker_transport_options={"confirm_publish": True},
    broker_native_delayed_delivery_queue_type="quorum",
    task_acks_late=True,
    task_reject_on_worker_lost=True,
    worker_prefetch_multiplier=max(1, PREFETCH // PROCESSES),
    result_persistent=True,
    task_delivery_mode="persistent",
    worker_send_task_events=False,
    task_send_sent_event=False,
)


@app.task(name="noop")
def noop(name):
    """A row that says nothing, about as long as ours is at least."""
    return {"video": name, "status": "static", "reason": "no-op"}


def main():
    jobs = int(sys.argv[1])
    noop.delay("warm-up").get(timeout=60)
    # Several publishers begin together.
    time.sleep(max(0.0, float(os.environ.get("FLEET_START_S", "0")) - time.monotonic()))
    started = time.monotonic()
    results = [noop.delay(f"noop/{index:06}.mp4") for index in range(jobs)]
    published = time.monotonic()
    rows = ResultSet(results).join_native(timeout=300)
    collected = time.monotonic()
    assert sorted(row["video"] for row in rows) == [f"noop/{index:06}.mp4" for index in range(jobs)]
    print(
        json.dumps(
            {
                "jobs": jobs,
                "started_s": started,
                "published_s": published,
                "collected_s": collected,
            }
        )
    )


if __name__ == "__main__":
    main()
