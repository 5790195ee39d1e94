//! What a browser may ask: the page's files, the picture of now or of a moment, a station's series, what comes from now on.

use crate::hub::Hub;
use crate::picture::{AZIGRAMS, POINTS, Picture};
use anyhow::{Context, Result};
use axum::Router;
use axum::extract::{Path, Query, State};
use axum::http::{HeaderMap, HeaderName, StatusCode, header};
use axum::response::sse::{Event, KeepAlive, Sse};
use axum::response::{IntoResponse, Response};
use axum::routing::{get, post};
use futures_util::stream::{self, Stream};
use seabearing_base::store::{History, Moment};
use serde::Serialize;
use serde_json::{Value, json};
use std::collections::HashMap;
use std::convert::Infallible;
use std::net::TcpListener;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use tokio::sync::broadcast::error::RecvError;

/// The files that run in the browser.
const FILES: [(&str, &str, &str); 11] = [
    ("/", "text/html; charset=utf-8", include_str!("../web/index.html")),
    ("/page.css", "text/css; charset=utf-8", include_str!("../web/page.css")),
    ("/page.js", "text/javascript; charset=utf-8", include_str!("../web/page.js")),
    ("/model.js", "text/javascript; charset=utf-8", include_str!("../web/model.js")),
    ("/health.js", "text/javascript; charset=utf-8", include_str!("../web/health.js")),
    ("/coast.js", "text/javascript; charset=utf-8", include_str!("../web/coast.js")),
    ("/map.js", "text/javascript; charset=utf-8", include_str!("../web/map.js")),
    ("/sphere.js", "text/javascript; charset=utf-8", include_str!("../web/sphere.js")),
    ("/azigram.js", "text/javascript; charset=utf-8", include_str!("../web/azigram.js")),
    ("/plots.js", "text/javascript; charset=utf-8", include_str!("../web/plots.js")),
    ("/words.js", "text/javascript; charset=utf-8", include_str!("../web/words.js")),
];

/// Nothing is loaded from anywhere else, nothing is framed, nothing is guessed.
const HEADERS: [(HeaderName, &str); 4] = [
    (
        header::CONTENT_SECURITY_POLICY,
        "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; img-src 'self' data:; \
         base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    ),
    (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
    (header::REFERRER_POLICY, "no-referrer"),
    (header::CACHE_CONTROL, "no-cache"),
];

/// Browsers that may listen at once.
const LISTENERS: usize = 100;
/// Longest interval that may be asked for, ms.
const LONGEST_MS: f64 = 366.0 * 86_400e3;
/// How far back a moment's tracks go unless it is said, ms.
const WINDOW_MS: f64 = 3_600e3;

struct Shared {
    hub: Arc<Hub>,
    store: Option<PathBuf>,
    /// The store, opened by the first who looks back.
    history: Mutex<Option<History>>,
    places: Value,
}

/// Serves in a thread of its own.
pub fn start(listener: TcpListener, hub: Arc<Hub>, store: Option<PathBuf>, places: Value) -> Result<()> {
    let shared = Arc::new(Shared { hub, store, history: Mutex::new(None), places });
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build();
    let runtime = runtime.context("cannot serve the page")?;
    let serve = move || -> Result<()> {
        runtime.block_on(async {
            let listener = tokio::net::TcpListener::from_std(listener)?;
            Ok(axum::serve(listener, router(shared)).await?)
        })
    };
    let guarded = move || {
        if let Err(e) = serve() {
            log::warn!("the page is served no more: {e:#}; storing goes on");
        }
    };
    std::thread::Builder::new().name("page".into()).spawn(guarded).context("cannot serve the page")?;
    Ok(())
}

fn router(shared: Arc<Shared>) -> Router {
    let mut router = Router::new()
        .route("/api/moment", get(moment))
        .route("/api/series", get(series))
        .route("/api/live", get(live))
        .route("/api/alarms", get(alarms))
        .route("/api/alarms/{id}/acknowledge", post(acknowledge));
    for (path, kind, text) in FILES {
        router = router.route(path, get(move || async move { with(kind, text) }));
    }
    router
        .fallback(|| async { (StatusCode::NOT_FOUND, HEADERS, "there is no such page\n") })
        .with_state(shared)
}

fn with(kind: &'static str, body: impl IntoResponse) -> Response {
    ([(header::CONTENT_TYPE, kind)], HEADERS, body).into_response()
}

fn answer<T: Serialize>(value: Result<T>) -> Response {
    match value.and_then(|value| Ok(serde_json::to_string(&value)?)) {
        Ok(text) => with("application/json", text),
        Err(e) => refused(StatusCode::INTERNAL_SERVER_ERROR, &format!("{e:#}")),
    }
}

fn refused(status: StatusCode, why: &str) -> Response {
    (status, with("application/json", json!({ "error": why }).to_string())).into_response()
}

type Asked = Query<HashMap<String, String>>;

/// A number of a request. `Err`: what is wrong with it.
fn number(asked: &Asked, key: &str) -> Result<Option<f64>, String> {
    let Some(text) = asked.get(key) else { return Ok(None) };
    let number = text.parse::<f64>().ok().filter(|x| x.is_finite() && x.abs() < 9e15);
    number.map(Some).ok_or_else(|| format!("{key}={text}: a number of milliseconds since 1970 or a station"))
}

/// Why a request is not answered.
struct Refusal(StatusCode, String);

impl IntoResponse for Refusal {
    fn into_response(self) -> Response {
        refused(self.0, &self.1)
    }
}

/// Looks into the store, in a thread that may wait for the disk.
async fn look(
    shared: Arc<Shared>,
    what: impl FnOnce(&History) -> Result<String> + Send + 'static,
) -> Response {
    look_for(shared, what).await.map(|text| with("application/json", text)).into_response()
}

/// The same, as a value.
async fn look_for<T: Send + 'static>(
    shared: Arc<Shared>,
    what: impl FnOnce(&History) -> Result<T> + Send + 'static,
) -> Result<T, Refusal> {
    let task = tokio::task::spawn_blocking(move || {
        let Some(folder) = &shared.store else {
            let why = "there is no store to look back into: start the base station with --store DIR";
            return Err(Refusal(StatusCode::NOT_FOUND, why.into()));
        };
        let mut history = shared.history.lock().unwrap_or_else(PoisonError::into_inner);
        let found = (|| {
            if history.is_none() {
                *history = Some(History::open(folder)?);
            }
            what(history.as_ref().context("the store is not open")?)
        })();
        found.map_err(|e| {
            // It is opened again for the next.
            *history = None;
            Refusal(StatusCode::INTERNAL_SERVER_ERROR, format!("{e:#}"))
        })
    });
    let failed = |_| Refusal(StatusCode::INTERNAL_SERVER_ERROR, "looking into the store has failed".into());
    task.await.unwrap_or_else(|e| Err(failed(e)))
}

/// A picture, with where stations are, the time now, and the store's first and last moment (ms since 1970).
#[derive(Serialize)]
struct Shown<'a> {
    #[serde(flatten)]
    picture: &'a Picture,
    places: &'a Value,
    now: f64,
    span: Option<[i64; 2]>,
}

/// The picture of now, or of `at` (ms since 1970) with tracks since `window` ms before.
async fn moment(State(shared): State<Arc<Shared>>, asked: Asked) -> Response {
    let (at, window) = match (number(&asked, "at"), number(&asked, "window")) {
        (Ok(at), Ok(window)) => (at, window.unwrap_or(WINDOW_MS).clamp(0.0, LONGEST_MS)),
        (Err(e), _) | (_, Err(e)) => return refused(StatusCode::BAD_REQUEST, &e),
    };
    let Some(at) = at else {
        let span = match &shared.store {
            Some(_) => look_for(Arc::clone(&shared), History::span_us).await,
            None => Ok(None),
        };
        let span = match span {
            Ok(span) => span.map(|(from, to)| [from / 1000, to / 1000]),
            Err(refusal) => return refusal.into_response(),
        };
        let picture = shared.hub.picture();
        return answer(Ok(Shown { picture: &picture, places: &shared.places, now: now_ms(), span }));
    };
    let places = shared.places.clone();
    look(shared, move |history| {
        let at_us = (at * 1e3) as i64;
        let then = Picture::of(&history.moment(at_us, at_us - (window * 1e3) as i64)?);
        Ok(serde_json::to_string(&Shown { picture: &then, places: &places, now: now_ms(), span: None })?)
    })
    .await
}

/// The series of a station: of now, or from `from` to `to` (ms since 1970) from the store.
async fn series(State(shared): State<Arc<Shared>>, asked: Asked) -> Response {
    let (station, from, to) = match (number(&asked, "station"), number(&asked, "from"), number(&asked, "to"))
    {
        (Ok(station), Ok(from), Ok(to)) => (station, from, to),
        (Err(e), ..) | (_, Err(e), _) | (.., Err(e)) => return refused(StatusCode::BAD_REQUEST, &e),
    };
    let of = station.filter(|s| (0.0..65_536.0).contains(s)).map(|s| s as u16);
    let Some((from, to)) = from.zip(to).filter(|_| shared.store.is_some()) else {
        return answer(Ok(shared.hub.picture().series(of.map(u64::from))));
    };
    if !(to >= from && to - from <= LONGEST_MS) {
        return refused(
            StatusCode::BAD_REQUEST,
            "`to` must not be before `from`, nor more than a year after it",
        );
    }
    look(shared, move |history| {
        let mut moment = Moment::default();
        // Bearings, health, azimuths, ranges and azigrams, by the numbers of their messages.
        for (kind, most) in [(1, POINTS), (3, POINTS), (4, POINTS), (5, POINTS), (16, AZIGRAMS)] {
            moment.records.extend(history.series(of, kind, (from * 1e3) as i64, (to * 1e3) as i64, most)?);
        }
        Ok(serde_json::to_string(&Picture::of(&moment).series(of.map(u64::from)))?)
    })
    .await
}

/// What comes from now on, as server-sent events.
async fn live(State(shared): State<Arc<Shared>>) -> Response {
    if shared.hub.listeners() >= LISTENERS {
        return refused(StatusCode::SERVICE_UNAVAILABLE, "too many browsers are listening");
    }
    (HEADERS, Sse::new(events(&shared.hub)).keep_alive(KeepAlive::new().interval(Duration::from_secs(10))))
        .into_response()
}

fn events(hub: &Hub) -> impl Stream<Item = Result<Event, Infallible>> + use<> {
    stream::unfold(hub.subscribe(), |mut batches| async move {
        let text = match batches.recv().await {
            Ok(text) => text,
            // It was too slow, and looks at the picture anew.
            Err(RecvError::Lagged(_)) => json!({ "behind": true }).to_string().into(),
            Err(RecvError::Closed) => return None,
        };
        Some((Ok(Event::default().data(text)), batches))
    })
}

/// The alarms, oldest first.
async fn alarms(State(shared): State<Arc<Shared>>) -> Response {
    answer(Ok(shared.hub.picture().alarms()))
}

/// A person has seen an alarm. Only this page's own script may say so.
async fn acknowledge(
    State(shared): State<Arc<Shared>>,
    Path(id): Path<String>,
    headers: HeaderMap,
) -> Response {
    let from = headers.get("sec-fetch-site").map(|v| v.as_bytes());
    if from.is_some_and(|site| site != b"same-origin") {
        return refused(StatusCode::FORBIDDEN, "another page may not acknowledge alarms");
    }
    let alarms = shared.hub.picture().alarms();
    let known = |alarm: &&Value| match &alarm["id"] {
        Value::String(name) => *name == id,
        number => id.parse::<u64>().is_ok_and(|id| *number == id),
    };
    match alarms.as_array().into_iter().flatten().find(known) {
        Some(alarm) => {
            shared.hub.acknowledge(&alarm["id"]);
            answer(Ok(json!({ "acknowledged": alarm["id"] })))
        }
        None => refused(StatusCode::NOT_FOUND, &format!("there is no alarm {id}")),
    }
}

fn now_ms() -> f64 {
    (time::OffsetDateTime::now_utc().unix_timestamp_nanos() / 1_000_000) as f64
}
