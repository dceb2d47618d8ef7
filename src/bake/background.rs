//! Bakes that nobody waits for.

/// Runs `work` on threads of its own, one less than there are cores and behind all others that want to run, so that lights
/// can be edited meanwhile.
pub fn low_priority<R: Send>(work: impl FnOnce() -> R + Send) -> R {
    let threads = rayon::current_num_threads().saturating_sub(1).max(1);
    match rayon::ThreadPoolBuilder::new().num_threads(threads).start_handler(|_| give_way()).build() {
        Ok(pool) => pool.install(work),
        Err(_) => work(), // no more threads are to be had
    }
}

/// Lets other threads go first; on Linux a thread has a priority of its own, elsewhere it would be the whole program's.
fn give_way() {
    #[cfg(target_os = "linux")]
    if let Err(error) = rustix::process::setpriority_process(None, 10) {
        tracing::info!("a bake in the background has the priority of all else: {error}");
    }
}
