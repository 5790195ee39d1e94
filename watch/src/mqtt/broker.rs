//! Where a broker is and how it is spoken to: an address, or a small TOML file.

use anyhow::{Context, Result, bail};
use rumqttc::{MqttOptions, TlsConfiguration, Transport};
use seabearing_host::toml_file::TomlFile;
use serde::Deserialize;
use std::path::{Path, PathBuf};

/// Topics begin so where nothing else is said.
const PREFIX: &str = "seabearing";
/// Longest prefix, bytes.
const LONGEST: usize = 1024;
/// Records that wait in memory where there is no store.
const ROOM: usize = 100_000;

/// A broker.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Broker {
    host: String,
    port: u16,
    tls: Option<Tls>,
    user: Option<(String, String)>,
    /// Before all topics, without a slash at its end.
    pub prefix: String,
    /// What this base station is called there; a number of its own where nothing is said.
    pub name: Option<String>,
    /// Publish what the store holds already, too, where nothing was published yet.
    pub backfill: bool,
    /// Records that wait in memory at most where there is no store.
    pub room: usize,
    /// Topics subscribed to; those of all stations under the prefix where none are said.
    pub topics: Vec<String>,
    /// Consumer group that shares them.
    pub group: Option<String>,
}

/// What TLS needs beside the broker's name; PEM texts.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
struct Tls {
    /// Who vouches for the broker; the system's authorities where nothing is said.
    ca: Option<Vec<u8>>,
    /// This client's certificate and key.
    client: Option<(Vec<u8>, Vec<u8>)>,
}

/// The keys of the file.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    url: String,
    name: Option<String>,
    password_file: Option<PathBuf>,
    ca_file: Option<PathBuf>,
    certificate_file: Option<PathBuf>,
    key_file: Option<PathBuf>,
    backfill: Option<bool>,
    waiting_records: Option<usize>,
    topics: Option<Vec<String>>,
    group: Option<String>,
}

impl Broker {
    /// From `mqtt://[USER@]HOST[:PORT][/PREFIX]`, the same with `mqtts`, or the path of a TOML file; files that it names stand
    /// beside it.
    ///
    /// # Errors
    /// One line: what is wrong, and what was expected.
    pub fn read(text: &str) -> Result<Self> {
        if text.contains("://") {
            return Self::of_url(text);
        }
        let path = Path::new(text);
        let source = TomlFile::read(path, "broker file")?;
        let file: File = source.parse()?;
        let beside = |key: &str, name: &PathBuf| {
            let at = path.parent().unwrap_or(Path::new(".")).join(name);
            std::fs::read(&at).with_context(|| format!("{}: cannot read {}", source.at(key), at.display()))
        };
        let pem = |key: &str, name: &Option<PathBuf>, what: &str| {
            let Some(name) = name else { return Ok(None) };
            let bytes = beside(key, name)?;
            if !String::from_utf8_lossy(&bytes).contains(what) {
                return Err(source.wrong(key, format!("{}: no PEM file with a `{what}`", name.display())));
            }
            Ok(Some(bytes))
        };
        let mut broker = Self::of_url(&file.url).map_err(|e| source.wrong("url", e))?;
        let ca = pem("ca_file", &file.ca_file, "BEGIN CERTIFICATE")?;
        let certificate = pem("certificate_file", &file.certificate_file, "BEGIN CERTIFICATE")?;
        let key = pem("key_file", &file.key_file, "PRIVATE KEY")?;
        match &mut broker.tls {
            Some(tls) => {
                tls.ca = ca;
                tls.client = match (certificate, key) {
                    (Some(certificate), Some(key)) => Some((certificate, key)),
                    (None, None) => None,
                    (Some(_), None) => return Err(source.wrong("certificate_file", "`key_file` is missing")),
                    (None, Some(_)) => return Err(source.wrong("key_file", "`certificate_file` is missing")),
                };
            }
            None if ca.is_some() || certificate.is_some() || key.is_some() => {
                return Err(source.wrong("url", "certificates are for `mqtts://`"));
            }
            None => {}
        }
        if let Some(name) = &file.password_file {
            let Some((_, password)) = &mut broker.user else {
                return Err(source.wrong("password_file", "no user: url = \"mqtts://USER@HOST\""));
            };
            let bytes = beside("password_file", name)?;
            *password = String::from_utf8(bytes)
                .context("a password is no text")?
                .trim_end_matches(['\r', '\n'])
                .to_owned();
        }
        for (key, text) in [("name", &file.name), ("group", &file.group)] {
            if text.as_deref().is_some_and(|text| !plain(text)) {
                return Err(source.wrong(key, "letters, digits, `.`, `_` and `-` were expected, at most 64"));
            }
        }
        if file.topics.iter().flatten().any(|topic| topic.is_empty() || topic.contains('\0')) {
            return Err(source.wrong("topics", "a topic is empty"));
        }
        broker.name = file.name;
        broker.group = file.group;
        broker.topics = file.topics.unwrap_or_default();
        broker.backfill = file.backfill.unwrap_or(false);
        broker.room = file.waiting_records.unwrap_or(ROOM).clamp(1, 10_000_000);
        Ok(broker)
    }

    fn of_url(text: &str) -> Result<Self> {
        const FORM: &str = "mqtt://[USER@]HOST[:PORT][/PREFIX] or mqtts://.. was expected";
        let (kind, rest) = text.split_once("://").unwrap_or_default();
        let tls = match kind {
            "mqtt" => None,
            "mqtts" => Some(Tls::default()),
            _ => bail!("`{text}`: {FORM}"),
        };
        let (place, prefix) = rest.split_once('/').unwrap_or((rest, PREFIX));
        let (user, place) = match place.rsplit_once('@') {
            Some((user, _)) if user.contains(':') => {
                bail!(
                    "a password in an address is seen by everybody: `password_file` of a broker file is for it"
                )
            }
            Some((user, place)) => (Some((user.to_owned(), String::new())), place),
            None => (None, place),
        };
        let port = if tls.is_some() { 8883 } else { 1883 };
        let bracketed = place.strip_prefix('[').and_then(|p| p.split_once(']'));
        let (host, port) = match (bracketed, place.rsplit_once(':')) {
            (Some((host, "")), _) => (host, port),
            (Some((host, more)), _) => {
                (host, number(more.strip_prefix(':')).with_context(|| format!("`{text}`: {FORM}"))?)
            }
            (None, Some((host, more))) => {
                (host, number(Some(more)).with_context(|| format!("`{text}`: {FORM}"))?)
            }
            (None, None) => (place, port),
        };
        if host.is_empty() || host.contains(char::is_whitespace) {
            bail!("`{text}`: {FORM}");
        }
        let prefix = prefix.trim_end_matches('/');
        if prefix.is_empty()
            || prefix.len() > LONGEST
            || prefix.contains(['+', '#', '\0'])
            || prefix.starts_with('$')
        {
            bail!(
                "`{text}`: `{prefix}` is no beginning of topics: no `+`, no `#`, no `$` at its begin, not empty"
            );
        }
        Ok(Self {
            host: host.to_owned(),
            port,
            tls,
            user,
            prefix: prefix.to_owned(),
            name: None,
            backfill: false,
            room: ROOM,
            topics: Vec::new(),
            group: None,
        })
    }

    /// How a client of this name speaks to it.
    ///
    /// # Errors
    /// The system's certificates cannot be read.
    pub(super) fn options(&self, client: &str) -> Result<MqttOptions> {
        let mut options = MqttOptions::new(client, (self.host.clone(), self.port));
        options.set_keep_alive(super::KEEP_ALIVE_S);
        if let Some((user, password)) = &self.user {
            options.set_credentials(user.clone(), password.clone());
        }
        if let Some(tls) = &self.tls {
            options.set_transport(Transport::Tls(match &tls.ca {
                Some(ca) => {
                    TlsConfiguration::Simple { ca: ca.clone(), alpn: None, client_auth: tls.client.clone() }
                }
                None => TlsConfiguration::try_default_rustls().context("the system's certificates")?,
            }));
        }
        Ok(options)
    }

    /// Whether what is published to another is subscribed to here: it would come back for ever.
    pub fn hears(&self, other: &Self) -> bool {
        let published = format!("{}/1/bearing", other.prefix);
        let same = (&self.host, self.port) == (&other.host, other.port);
        same && self.all_topics().iter().any(|filter| matches(filter, &published))
    }

    fn all_topics(&self) -> Vec<String> {
        match self.topics.is_empty() {
            true => vec![format!("{}/+/+", self.prefix)],
            false => self.topics.clone(),
        }
    }

    /// The topics subscribed to, as the broker wants them.
    pub(super) fn filters(&self) -> Vec<String> {
        let shared = |topic: &String| match &self.group {
            Some(group) => format!("$share/{group}/{topic}"),
            None => topic.clone(),
        };
        self.all_topics().iter().map(shared).collect()
    }
}

impl std::fmt::Display for Broker {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let kind = if self.tls.is_some() { "mqtts" } else { "mqtt" };
        match self.host.contains(':') {
            true => write!(f, "{kind}://[{}]:{}", self.host, self.port),
            false => write!(f, "{kind}://{}:{}", self.host, self.port),
        }
    }
}

/// Whether a filter of topics takes a topic.
fn matches(filter: &str, topic: &str) -> bool {
    let (mut filter, mut topic) = (filter.split('/'), topic.split('/'));
    loop {
        match (filter.next(), topic.next()) {
            (Some("#"), _) | (None, None) => return true,
            (Some("+"), Some(_)) => {}
            (Some(wanted), Some(level)) if wanted == level => {}
            _ => return false,
        }
    }
}

fn number(port: Option<&str>) -> Option<u16> {
    port?.parse().ok().filter(|port| *port > 0)
}

/// Whether a name can stand in topics, client ids and groups.
fn plain(name: &str) -> bool {
    let of = |c: char| c.is_ascii_alphanumeric() || "._-".contains(c);
    !name.is_empty() && name.len() <= 64 && name.chars().all(of)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_address_is_what_it_says_or_refused_with_what_was_expected() {
        let broker = Broker::read("mqtt://sea.example").unwrap();
        assert_eq!((broker.to_string().as_str(), &*broker.prefix), ("mqtt://sea.example:1883", "seabearing"));
        assert_eq!(broker.filters(), ["seabearing/+/+"]);
        let hears = |url: &str| broker.hears(&Broker::read(url).unwrap());
        assert!(hears("mqtt://sea.example") && hears("mqtt://me@sea.example:1883/seabearing"));
        assert!(!hears("mqtt://sea.example/seabearing/north") && !hears("mqtt://lake.example"));
        let topics = |topic: &str| Broker { topics: vec![topic.to_owned()], ..broker.clone() };
        let north = Broker::read("mqtt://sea.example/seabearing/north").unwrap();
        assert!(topics("#").hears(&north) && topics("seabearing/+/+/+").hears(&north));
        assert!(!topics("seabearing/south/#").hears(&north) && !topics("seabearing/+").hears(&north));
        let broker = Broker::read("mqtts://me@[::1]:99/north sea/ä/").unwrap();
        assert_eq!((broker.to_string().as_str(), &*broker.prefix), ("mqtts://[::1]:99", "north sea/ä"));
        assert_eq!(broker.user, Some(("me".to_owned(), String::new())));
        assert_eq!(Broker::read("mqtts://[fe80::1]").unwrap().port, 8883);
        for (wrong, said) in [
            ("http://a", "mqtt://[USER@]HOST"),
            ("mqtt://", "was expected"),
            ("mqtt://a:b", "was expected"),
            ("mqtt://a:0", "was expected"),
            ("mqtt://a/b/+", "no beginning of topics"),
            ("mqtt://a/$SYS", "no beginning of topics"),
            ("mqtt://a//", "no beginning of topics"),
            ("mqtt://me:secret@a", "password_file"),
        ] {
            let e = Broker::read(wrong).unwrap_err().to_string();
            assert!(e.contains(said), "{wrong}: {e}");
            assert!(!e.contains("secret"), "{e}");
        }
    }

    #[test]
    fn a_file_says_the_rest_and_what_is_wrong_in_it_is_named_with_its_place() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("broker.toml");
        let read = |text: &str| {
            std::fs::write(&path, text).unwrap();
            Broker::read(path.to_str().unwrap())
        };
        std::fs::write(dir.path().join("secret"), "over and out\n").unwrap();
        std::fs::write(dir.path().join("ca.crt"), "-----BEGIN CERTIFICATE-----\n").unwrap();
        let broker = read(
            "url = \"mqtts://me@sea:8884/north\"\nname = \"pier-1\"\npassword_file = \"secret\"\nca_file = \"ca.crt\"\n\
             group = \"fusion\"\ntopics = [\"north/+/+\", \"south/+/+\"]\nbackfill = true\nwaiting_records = 5\n",
        )
        .unwrap();
        assert_eq!(broker.user, Some(("me".to_owned(), "over and out".to_owned())));
        assert_eq!(broker.filters(), ["$share/fusion/north/+/+", "$share/fusion/south/+/+"]);
        assert!(broker.backfill && broker.room == 5 && broker.name.as_deref() == Some("pier-1"));
        for (wrong, said) in [
            ("url = \"mqtt://sea\"\nca_file = \"ca.crt\"\n", "certificates are for `mqtts://`"),
            ("url = \"mqtts://sea\"\nca_file = \"secret\"\n", "line 2"),
            ("url = \"mqtts://sea\"\nca_file = \"none\"\n", "cannot read"),
            ("url = \"mqtts://sea\"\ncertificate_file = \"ca.crt\"\n", "`key_file` is missing"),
            ("url = \"mqtt://sea\"\npassword_file = \"secret\"\n", "no user"),
            ("url = \"mqtt://sea\"\nname = \"a/b\"\n", "letters, digits"),
            ("url = \"mqtt://sea\"\nqos = 2\n", "qos"),
            ("url = \"sea\"\n", "line 1"),
        ] {
            let e = format!("{:#}", read(wrong).unwrap_err());
            assert!(e.contains(said) && e.contains("broker.toml"), "{wrong}: {e}");
        }
    }
}
