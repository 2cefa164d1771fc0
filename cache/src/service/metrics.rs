//! What is counted, as Prometheus reads it.

use std::fmt::Write as _;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

/// Counters and gauges. Any thread may add to them.
#[derive(Debug, Default)]
pub(super) struct Metrics {
    pub(super) requests: AtomicU64,
    pub(super) refused: AtomicU64,
    pub(super) failed: AtomicU64,
    pub(super) bytes: AtomicU64,
    pub(super) filed_bytes: Arc<AtomicU64>,
    pub(super) hits: AtomicU64,
    pub(super) faults: AtomicU64,
    pub(super) damaged: AtomicU64,
    pub(super) read_nanos: AtomicU64,
    pub(super) reading: AtomicU64,
    pub(super) connections: AtomicU64,
    pub(super) inserted: AtomicU64,
    pub(super) insertions_failed: AtomicU64,
    pub(super) accept_errors: AtomicU64,
}

/// What is asked of others when the metrics are.
#[derive(Clone, Copy, Debug)]
pub(super) struct Gauges {
    pub(super) in_flight: usize,
    pub(super) memory_bytes: u64,
    pub(super) budget_bytes: u64,
    pub(super) generation: u64,
    pub(super) datasets: usize,
    pub(super) inserting: usize,
}

impl Metrics {
    pub(super) fn text(&self, gauges: Gauges) -> String {
        let mut text = String::new();
        let mut put = |kind: &str, name: &str, help: &str, value: f64| {
            // Writing to a string does not fail.
            let _ = write!(
                text,
                "# HELP areoid_{name} {help}\n# TYPE areoid_{name} {kind}\nareoid_{name} {value}\n"
            );
        };
        let of = |counter: &AtomicU64| counter.load(Relaxed) as f64;
        put("counter", "requests_total", "Requests.", of(&self.requests));
        put("counter", "refused_total", "Requests and connections refused.", of(&self.refused));
        put("counter", "failed_total", "Requests answered with 5xx.", of(&self.failed));
        put("counter", "bytes_total", "Bytes of pages and archives.", of(&self.bytes));
        let filed = of(&self.filed_bytes);
        put("counter", "filed_bytes_total", "Of those, sent from archives without a copy.", filed);
        put("counter", "page_hits_total", "Pages answered from memory.", of(&self.hits));
        put("counter", "page_faults_total", "Pages read from disk.", of(&self.faults));
        put("counter", "damaged_total", "Reads that failed.", of(&self.damaged));
        let seconds = of(&self.read_nanos) / 1e9;
        put("counter", "read_seconds_total", "Time spent reading pages.", seconds);
        put("gauge", "reads_waiting", "Reads queued or under way.", of(&self.reading));
        put("gauge", "connections", "Connections.", of(&self.connections));
        put("gauge", "requests_in_flight", "Requests in flight.", gauges.in_flight as f64);
        put("gauge", "memory_bytes", "Bytes of pages in memory.", gauges.memory_bytes as f64);
        put("gauge", "memory_budget_bytes", "Their budget.", gauges.budget_bytes as f64);
        put("gauge", "generation", "Generation of the catalog.", gauges.generation as f64);
        put("gauge", "datasets", "Datasets served.", gauges.datasets as f64);
        let inserting = gauges.inserting as f64;
        put("gauge", "inserting", "Insertions under way or waiting.", inserting);
        put("counter", "inserted_total", "Insertions done.", of(&self.inserted));
        put("counter", "insertions_failed_total", "Failed.", of(&self.insertions_failed));
        put("counter", "accept_errors_total", "Connections not taken.", of(&self.accept_errors));
        text
    }
}
