//! Who keeps a station's configuration: the part of a recorder that takes another over the link, or says that it cannot.

use crate::wire::Fault;
use crate::wire::configure::Configure;

/// `Reply.status` of what was done.
pub const DONE: u8 = 0;
/// `Reply.status` of what was refused.
pub const REFUSED: u8 = 1;
/// `Reply.status` of what this recorder cannot do.
pub const UNKNOWN: u8 = 2;

/// What is to be done once something is finished.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Done {
    /// The order with this token is answered by this status.
    Reply(u8, u8),
    /// The recorder starts again; so the order with this token was answered, if there was one.
    Restart(Option<u8>),
}

/// Keeps the station's configurations, and takes new ones.
pub trait Keeper {
    /// Takes an order; what is to be done at once.
    fn take(&mut self, order: &Configure) -> Option<Done>;

    /// Does what is due by the board's clock; what is to be done now. `reached`: a base station has been heard since the start.
    fn work(&mut self, now_s: u32, reached: bool) -> Option<Done>;

    /// The recorder has samples.
    fn sampled(&mut self);

    /// What happened to a configuration before this start, once a start; no more at starts after it has come to stand in flash.
    fn news(&mut self) -> Option<Fault>;
}

/// No place for a configuration but where it was built in.
#[derive(Clone, Copy, Debug, Default)]
pub struct BuiltIn;

impl Keeper for BuiltIn {
    fn take(&mut self, order: &Configure) -> Option<Done> {
        Some(Done::Reply(order.token(), UNKNOWN))
    }

    fn work(&mut self, _: u32, _: bool) -> Option<Done> {
        None
    }

    fn sampled(&mut self) {}

    fn news(&mut self) -> Option<Fault> {
        None
    }
}
