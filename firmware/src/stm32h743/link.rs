//! Telemetry by DMA from a pipe, commands by DMA into a ring; frames enter the pipe whole or not at all.

use core::future::Future;
use embassy_stm32::mode::Async;
use embassy_stm32::usart::{RingBufferedUartRx, UartTx};
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::pipe::Pipe;
use seabearing_core::port::{Link, Supervisor};

/// Bytes waiting for the line: a second of the densest telemetry (20 bearings a second of 70 bytes, and tracks).
const PIPE_BYTES: usize = 4096;
/// Bytes a command link may bring between two looks.
pub const RING_BYTES: usize = 256;

/// So often a stopped stream is asked whether it has.
const STOPPING_READS: usize = 16;

static OUTBOX: Pipe<CriticalSectionRawMutex, PIPE_BYTES> = Pipe::new();

/// Sends what is in the pipe, for ever.
#[embassy_executor::task]
pub async fn transmit(mut uart: UartTx<'static, Async>) -> ! {
    let mut buffer = [0u8; 256];
    loop {
        let n = OUTBOX.read(&mut buffer).await;
        // A framing or DMA error loses these bytes; the receiver counts the frames they were.
        let _counted_by_the_receiver = uart.write(&buffer[..n]).await;
    }
}

/// Bytes that DMA puts into a ring.
pub struct Incoming {
    inbox: RingBufferedUartRx<'static>,
    /// Stream of DMA2 that does, and the ring's length.
    stream: usize,
    bytes: u16,
    waiting: [u8; 16],
    from: usize,
    to: usize,
}

impl Incoming {
    /// Begins to receive, by this stream of DMA2 and into a ring of so many bytes.
    pub fn new(inbox: RingBufferedUartRx<'static>, stream: usize, bytes: usize) -> Self {
        Self { inbox, stream, bytes: bytes as u16, waiting: [0; 16], from: 0, to: 0 }
    }

    /// The next byte, if there is one.
    pub fn byte(&mut self) -> Option<u8> {
        if self.from == self.to {
            // An overrun or a line error empties the ring; what it held fails its checksum.
            self.to = self.arrived();
            self.from = 0;
        }
        let byte = self.waiting.get(self.from).copied().filter(|_| self.from < self.to)?;
        self.from += 1;
        Some(byte)
    }

    /// Bytes that have arrived, without waiting. An error ends the reception and the next look begins it again: at once, because what comes
    /// until then is lost. The third finds the ring as the second left it, from its beginning.
    fn arrived(&mut self) -> usize {
        let mut context = core::task::Context::from_waker(core::task::Waker::noop());
        for _ in 0..3 {
            let polled = core::pin::pin!(self.inbox.read(&mut self.waiting)).poll(&mut context);
            match polled {
                core::task::Poll::Ready(Ok(n)) => return n,
                core::task::Poll::Ready(Err(_)) => {}
                core::task::Poll::Pending => return 0,
            }
            self.whole_again();
        }
        0
    }

    /// Gives a stream that an error has stopped its whole ring again: begun anew it would go round in what was left of it, at worst in a
    /// byte, and nothing be heard any more (RM0433, chapter 15; seen on the modelled board).
    fn whole_again(&self) {
        let stream = embassy_stm32::pac::DMA2.st(self.stream);
        // It stops when the transfer under way has ended.
        if (0..STOPPING_READS).any(|_| !stream.cr().read().en()) {
            stream.ndtr().write(|w| w.set_ndt(self.bytes));
        }
    }
}

/// The main loop's end of the line.
pub struct Serial {
    incoming: Incoming,
}

impl Serial {
    /// Takes commands from these bytes.
    pub fn new(incoming: Incoming) -> Self {
        Self { incoming }
    }

    /// Waits until everything said has left, a second at most.
    pub fn flush(&self, supervisor: &mut impl Supervisor) {
        for _ in 0..10 {
            supervisor.feed();
            embassy_time::block_for(embassy_time::Duration::from_millis(100));
            if OUTBOX.is_empty() {
                break;
            }
        }
    }
}

impl Link for Serial {
    fn send(&mut self, frame: &[u8]) -> bool {
        if OUTBOX.free_capacity() < frame.len() {
            return false;
        }
        let mut rest = frame;
        while let Ok(n) = OUTBOX.try_write(rest) {
            rest = rest.get(n..).unwrap_or_default();
            if rest.is_empty() {
                return true;
            }
        }
        false
    }

    fn receive(&mut self) -> Option<u8> {
        self.incoming.byte()
    }
}
