//! Queues inside one process, with the guarantees of a broker and memory that is bounded.
//!
//! A queue holds at most [`LocalOptions::capacity`] messages, those in work and those that wait for
//! their retry included; publishing waits for room. Dead letters are bounded, too: the oldest go.

use std::collections::{HashMap, HashSet, VecDeque};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use async_trait::async_trait;
use tokio::sync::{Notify, OwnedSemaphorePermit, Semaphore};

use super::error::QueueError;
use super::{
    Broker, Consumer, DeadLetter, Delivery, JobKind, Lease, MAX_DELIVERIES, Message, Queue, Settle,
    Settlement,
};
use crate::id::RunId;
use crate::observe::Pulse;

/// Sizes of the queues of one process.
#[derive(Debug, Clone, Copy)]
pub struct LocalOptions {
    /// Messages per queue.
    pub capacity: usize,
    /// Dead letters kept to look at; a run's rows do not depend on them.
    pub dead_letters: usize,
}

impl Default for LocalOptions {
    fn default() -> Self {
        Self {
            capacity: 1000,
            dead_letters: 10_000,
        }
    }
}

/// The broker of one process. Clones share its queues.
#[derive(Debug, Clone)]
pub struct LocalBroker {
    shared: Arc<Shared>,
}

#[derive(Debug)]
struct Shared {
    options: LocalOptions,
    queues: Mutex<HashMap<Queue, Arc<LocalQueue>>>,
    dead: Arc<LocalQueue>,
    leases: Mutex<HashSet<RunId>>,
}

#[derive(Debug)]
struct LocalQueue {
    name: Queue,
    room: Arc<Semaphore>,
    /// `None` once the queue is deleted.
    ready: Mutex<Option<VecDeque<Stored>>>,
    arrived: Notify,
    consumers: AtomicU64,
}

#[derive(Debug)]
struct Stored {
    message: Message,
    redeliveries: u32,
    dead: Option<DeadLetter>,
    /// Its place in the queue's capacity; dead letters have none.
    _room: Option<OwnedSemaphorePermit>,
}

impl LocalBroker {
    /// An empty broker.
    #[must_use]
    pub fn new(options: LocalOptions) -> Self {
        let always_there = JobKind::ALL.into_iter().map(Queue::Jobs);
        let mut queues: HashMap<_, _> = always_there
            .map(|name| (name.clone(), LocalQueue::new(name, &options)))
            .collect();
        let dead = LocalQueue::new(Queue::Dead, &options);
        queues.insert(Queue::Dead, Arc::clone(&dead));
        Self {
            shared: Arc::new(Shared {
                options,
                queues: Mutex::new(queues),
                dead,
                leases: Mutex::default(),
            }),
        }
    }

    fn find(&self, queue: &Queue) -> Result<Arc<LocalQueue>, QueueError> {
        let queues = lock(&self.shared.queues);
        queues.get(queue).cloned().ok_or_else(|| missing(queue))
    }
}

impl Shared {
    fn bury(&self, stored: Stored, queue: &Queue, reason: String) {
        let letter = Stored {
            dead: Some(DeadLetter {
                queue: Some(queue.clone()),
                reason,
            }),
            redeliveries: 0,
            _room: None,
            ..stored
        };
        if let Some(ready) = lock(&self.dead.ready).as_mut()
            && ready.len() >= self.options.dead_letters
        {
            tracing::warn!("too many dead letters; the oldest is dropped");
            ready.pop_front();
        }
        self.dead.push_back(letter);
    }

    /// Back to the front, for the next receiver.
    fn give_back(&self, queue: &LocalQueue, mut stored: Stored) {
        stored.redeliveries += 1;
        if stored.redeliveries >= MAX_DELIVERIES {
            self.bury(stored, &queue.name, "delivery_limit".to_owned());
        } else if let Some(ready) = lock(&queue.ready).as_mut() {
            ready.push_front(stored);
            queue.arrived.notify_one();
        }
    }
}

impl LocalQueue {
    fn new(name: Queue, options: &LocalOptions) -> Arc<Self> {
        Arc::new(Self {
            name,
            room: Arc::new(Semaphore::new(options.capacity)),
            ready: Mutex::new(Some(VecDeque::new())),
            arrived: Notify::new(),
            consumers: AtomicU64::new(0),
        })
    }

    /// Gives the message back where the queue is deleted.
    fn push_back(&self, stored: Stored) -> Option<Stored> {
        match lock(&self.ready).as_mut() {
            None => return Some(stored),
            Some(ready) => ready.push_back(stored),
        }
        self.arrived.notify_one();
        None
    }

    async fn pop(&self) -> Result<Stored, QueueError> {
        loop {
            let arrived = self.arrived.notified();
            match lock(&self.ready).as_mut().map(VecDeque::pop_front) {
                None => return Err(missing(&self.name)),
                Some(Some(stored)) => return Ok(stored),
                Some(None) => {}
            }
            arrived.await;
        }
    }
}

#[async_trait]
impl Broker for LocalBroker {
    async fn declare(&self, queue: &Queue) -> Result<(), QueueError> {
        let options = &self.shared.options;
        lock(&self.shared.queues)
            .entry(queue.clone())
            .or_insert_with(|| LocalQueue::new(queue.clone(), options));
        Ok(())
    }

    async fn publish(&self, queue: &Queue, message: Message) -> Result<(), QueueError> {
        message.check_size(&queue.to_string())?;
        let local = self.find(queue)?;
        let room = Arc::clone(&local.room).acquire_owned().await;
        let stored = Stored {
            message,
            redeliveries: 0,
            dead: None,
            _room: Some(room.map_err(|_deleted| missing(queue))?),
        };
        match local.push_back(stored) {
            None => Ok(()),
            Some(_deleted) => Err(missing(queue)),
        }
    }

    async fn consume(&self, queue: &Queue, slots: u16) -> Result<Box<dyn Consumer>, QueueError> {
        let queue = self.find(queue)?;
        queue.consumers.fetch_add(1, Ordering::Relaxed);
        Ok(Box::new(LocalConsumer {
            work: Arc::new(InWork {
                shared: Arc::clone(&self.shared),
                queue,
                held: Mutex::default(),
            }),
            slots: Arc::new(Semaphore::new(usize::from(slots.max(1)))),
            last_tag: 0,
            stopped: Arc::default(),
        }))
    }

    async fn ready(&self, queue: &Queue) -> Result<u64, QueueError> {
        let local = self.find(queue)?;
        let ready = lock(&local.ready).as_ref().map(VecDeque::len);
        ready.map(|n| n as u64).ok_or_else(|| missing(queue))
    }

    async fn consumers(&self, queue: &Queue) -> Result<u64, QueueError> {
        Ok(self.find(queue)?.consumers.load(Ordering::Relaxed))
    }

    async fn delete(&self, run: &RunId) -> Result<(), QueueError> {
        let removed = lock(&self.shared.queues).remove(&Queue::Results(run.clone()));
        if let Some(local) = removed {
            *lock(&local.ready) = None;
            local.room.close();
            local.arrived.notify_waiters();
        }
        Ok(())
    }

    async fn lease(&self, run: &RunId) -> Result<Option<Box<dyn Lease>>, QueueError> {
        let free = lock(&self.shared.leases).insert(run.clone());
        Ok(free.then(|| {
            Box::new(LocalLease {
                shared: Arc::clone(&self.shared),
                run: run.clone(),
            }) as Box<dyn Lease>
        }))
    }
}

#[derive(Debug)]
struct LocalConsumer {
    work: Arc<InWork>,
    slots: Arc<Semaphore>,
    last_tag: u64,
    stopped: Arc<AtomicBool>,
}

/// What a consumer handed out and was not settled.
#[derive(Debug)]
struct InWork {
    shared: Arc<Shared>,
    queue: Arc<LocalQueue>,
    held: Mutex<HashMap<u64, (Stored, OwnedSemaphorePermit)>>,
}

#[async_trait]
impl Consumer for LocalConsumer {
    async fn next(&mut self) -> Result<Delivery, QueueError> {
        let slot = Arc::clone(&self.slots).acquire_owned().await;
        let slot = slot.map_err(|_closed| missing(&self.work.queue.name))?;
        let stored = self.work.queue.pop().await?;
        self.last_tag += 1;
        let delivery = Delivery {
            message: stored.message.clone(),
            redeliveries: stored.redeliveries,
            dead: stored.dead.clone(),
            handle: Box::new(LocalHandle {
                work: Arc::clone(&self.work),
                tag: self.last_tag,
            }),
        };
        lock(&self.work.held).insert(self.last_tag, (stored, slot));
        Ok(delivery)
    }

    async fn stop(&mut self) {
        self.stopped.store(true, Ordering::Relaxed);
    }

    fn pulse(&self) -> Pulse {
        let stopped = Arc::clone(&self.stopped);
        Pulse::new(move || !stopped.load(Ordering::Relaxed))
    }
}

impl Drop for LocalConsumer {
    fn drop(&mut self) {
        self.work.queue.consumers.fetch_sub(1, Ordering::Relaxed);
        let held = std::mem::take(&mut *lock(&self.work.held));
        let mut held: Vec<_> = held.into_iter().collect();
        // The oldest ends up in front.
        held.sort_by_key(|(tag, _)| std::cmp::Reverse(*tag));
        for (_, (stored, _slot)) in held {
            self.work.shared.give_back(&self.work.queue, stored);
        }
    }
}

#[derive(Debug)]
struct LocalHandle {
    work: Arc<InWork>,
    tag: u64,
}

#[async_trait]
impl Settle for LocalHandle {
    async fn settle(
        self: Box<Self>,
        message: Message,
        settlement: Settlement,
    ) -> Result<(), QueueError> {
        let InWork {
            shared,
            queue,
            held,
        } = &*self.work;
        let Some((stored, _slot)) = lock(held).remove(&self.tag) else {
            return Err(QueueError::Lost {
                queue: queue.name.to_string(),
                message: message.id,
            });
        };
        match settlement {
            Settlement::Done => {}
            Settlement::Reject { reason } => shared.bury(stored, &queue.name, reason),
            Settlement::Retry { after } => {
                let (shared, queue) = (Arc::clone(shared), Arc::clone(queue));
                let again = Stored {
                    message: message.for_retry(),
                    redeliveries: 0,
                    ..stored
                };
                tokio::spawn(async move {
                    tokio::time::sleep(after).await;
                    if let Some(homeless) = queue.push_back(again) {
                        shared.bury(homeless, &queue.name, "expired".to_owned());
                    }
                });
            }
        }
        Ok(())
    }
}

#[derive(Debug)]
struct LocalLease {
    shared: Arc<Shared>,
    run: RunId,
}

#[async_trait]
impl Lease for LocalLease {
    async fn lost(&mut self) {
        std::future::pending::<()>().await;
    }

    async fn release(self: Box<Self>) {}
}

impl Drop for LocalLease {
    fn drop(&mut self) {
        lock(&self.shared.leases).remove(&self.run);
    }
}

fn missing(queue: &Queue) -> QueueError {
    QueueError::Missing {
        queue: queue.to_string(),
    }
}

/// A panic elsewhere leaves nothing half done under these locks.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
