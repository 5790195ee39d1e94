//! Where telemetry comes from, as a person writes it: a file, standard input, a serial device, a TCP peer.

use super::LINE_BAUD;
use anyhow::{Result, bail};
use std::path::PathBuf;

/// The places telemetry may come from.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Origin {
    /// A file; followed as it grows if asked.
    File {
        /// Where.
        path: PathBuf,
        /// Wait for more at its end.
        follow: bool,
    },
    /// Standard input.
    Stdin,
    /// A serial device.
    Serial {
        /// Device, e.g. `/dev/ttyACM0`.
        device: String,
        /// Bits a second.
        baud: u32,
    },
    /// Connect to `host:port`.
    Connect(String),
    /// Accept connections at `address:port`, any number at once.
    Listen(String),
}

impl Origin {
    /// From `listen:ADDR:PORT`, `tcp:HOST:PORT`, `serial:DEVICE:BAUD` or `file:PATH`.
    ///
    /// # Errors
    /// It is none of these.
    pub fn parse(text: &str) -> Result<Self> {
        let wrong = |what: &str| {
            format!("`{text}`: {what}; listen:ADDR:PORT, tcp:HOST:PORT, serial:DEVICE:BAUD or file:PATH")
        };
        let Some((kind, rest)) = text.split_once(':').filter(|(_, rest)| !rest.is_empty()) else {
            bail!(wrong("no line"))
        };
        let with_port = |rest: &str| {
            let port = rest.rsplit_once(':').filter(|(host, _)| !host.is_empty());
            port.is_some_and(|(_, port)| port.parse::<u16>().is_ok())
        };
        Ok(match kind {
            "file" => Self::File { path: rest.into(), follow: true },
            "tcp" if with_port(rest) => Self::Connect(rest.into()),
            "listen" if with_port(rest) => Self::Listen(rest.into()),
            "tcp" | "listen" => bail!(wrong("a port is missing")),
            "serial" => match rest.rsplit_once(':') {
                Some((device, baud)) => match baud.parse() {
                    Ok(baud @ 50..) => Self::Serial { device: device.into(), baud },
                    _ => bail!(wrong("no speed in bits a second")),
                },
                None => Self::Serial { device: rest.into(), baud: LINE_BAUD },
            },
            _ => bail!(wrong("no such kind of line")),
        })
    }

    /// Whether it comes to an end by itself.
    pub fn ends(&self) -> bool {
        matches!(self, Self::Stdin | Self::File { follow: false, .. })
    }

    /// Bits a second of the line.
    pub fn baud(&self) -> Option<u32> {
        if let Self::Serial { baud, .. } = self { Some(*baud) } else { None }
    }
}

impl std::fmt::Display for Origin {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::File { path, .. } => write!(f, "{}", path.display()),
            Self::Stdin => write!(f, "standard input"),
            Self::Serial { device, baud } => write!(f, "serial:{device}:{baud}"),
            Self::Connect(to) => write!(f, "tcp:{to}"),
            Self::Listen(at) => write!(f, "listen:{at}"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_are_what_they_say_or_refused() {
        assert_eq!(Origin::parse("listen:0.0.0.0:4500").unwrap(), Origin::Listen("0.0.0.0:4500".into()));
        assert_eq!(Origin::parse("tcp:[::1]:4500").unwrap(), Origin::Connect("[::1]:4500".into()));
        let serial = Origin::Serial { device: "/dev/ttyS0".into(), baud: 9600 };
        assert_eq!(Origin::parse("serial:/dev/ttyS0:9600").unwrap(), serial);
        assert!(matches!(Origin::parse("file:a/b.bin").unwrap(), Origin::File { .. }));
        for wrong in
            ["", "tcp", "tcp:", "tcp:host", "listen::4500x", "serial:/dev/x:fast", "serial:x:0", "udp:a:1"]
        {
            let said = Origin::parse(wrong).unwrap_err().to_string();
            assert!(said.contains(wrong) && said.contains("serial:DEVICE:BAUD"), "{said}");
        }
    }
}
