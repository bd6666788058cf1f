//! Plumbline: ids, score rows, messages, queues, configuration.
