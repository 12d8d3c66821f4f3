//! OpenTelemetry traces over OTLP/HTTP, to the collector that the operator names, and the trace that a caller is in
//! (W3C Trace Context: `traceparent`).

use super::TelemetryError;
use opentelemetry::Context;
use opentelemetry::trace::{SpanContext, SpanId, TraceContextExt, TraceFlags, TraceId, TraceState, TracerProvider};
use opentelemetry_otlp::{SpanExporter, WithExportConfig, WithHttpConfig};
use opentelemetry_sdk::Resource;
use opentelemetry_sdk::trace::{SdkTracer, SdkTracerProvider};
use std::collections::HashMap;
use std::time::Duration;
use tracing::Subscriber;
use tracing_opentelemetry::{OpenTelemetryLayer, OpenTelemetrySpanExt};
use tracing_subscriber::Layer;
use tracing_subscriber::filter::{LevelFilter, Targets};
use tracing_subscriber::registry::LookupSpan;

pub type Provider = SdkTracerProvider;

/// Where traces go.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Collector {
    /// As in `http://127.0.0.1:4318`.
    endpoint: String,
    headers: HashMap<String, String>,
}

impl Collector {
    /// `headers` are `name=value,name=value`.
    pub fn new(endpoint: &str, headers: Option<&str>) -> Result<Self, TelemetryError> {
        let pairs = headers.into_iter().flat_map(|headers| headers.split(',')).map(str::trim);
        let pairs = pairs.filter(|pair| !pair.is_empty()).map(|pair| {
            // The value is a secret: only the name is repeated.
            let name = pair.split('=').next().unwrap_or_default();
            let (name, value) = pair.split_once('=').ok_or_else(|| TelemetryError::Header(name.to_owned()))?;
            Ok((name.trim().to_owned(), value.trim().to_owned()))
        });
        Ok(Self { endpoint: endpoint.trim_end_matches('/').to_owned(), headers: pairs.collect::<Result<_, _>>()? })
    }
}

const SEND_TIME_MAX: Duration = Duration::from_secs(5);

pub fn provider(collector: &Collector) -> Result<Provider, TelemetryError> {
    let endpoint = &collector.endpoint;
    let exporter = SpanExporter::builder()
        .with_http()
        .with_endpoint(format!("{endpoint}/v1/traces"))
        .with_headers(collector.headers.clone())
        .with_timeout(SEND_TIME_MAX)
        .build()
        .map_err(|error| TelemetryError::Collector { endpoint: endpoint.clone(), reason: error.to_string() })?;
    let resource = Resource::builder().with_service_name("rigsmith").build();
    Ok(SdkTracerProvider::builder().with_batch_exporter(exporter).with_resource(resource).build())
}

/// The spans of this program, `info` and up, whatever is logged.
pub fn layer<S: Subscriber + for<'span> LookupSpan<'span>>(provider: &Provider) -> impl Layer<S> + use<S> {
    let tracer: SdkTracer = provider.tracer("rigsmith");
    let ours = Targets::new().with_target("rigsmith", LevelFilter::INFO);
    OpenTelemetryLayer::new(tracer).with_filter(ours)
}

/// Sends what is left. A collector that does not answer must not keep the program.
pub fn finish(provider: &Provider) {
    if let Err(error) = provider.shutdown_with_timeout(SEND_TIME_MAX) {
        eprintln!("the last traces were not sent: {error}");
    }
}

/// The place in a trace that a caller names.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TraceParent {
    trace: u128,
    span: u64,
    flags: u8,
}

impl TraceParent {
    /// Reads `traceparent`, version 00 and what later versions keep of it: `00-TRACE-SPAN-FLAGS`, lower-case
    /// hexadecimal, neither id zero.
    pub fn parse(text: &str) -> Option<Self> {
        let hex = |text: &str, digits: usize| {
            text.len() == digits && text.bytes().all(|byte| byte.is_ascii_digit() || (b'a'..=b'f').contains(&byte))
        };
        let mut parts = text.trim().splitn(5, '-');
        let (version, trace, span, flags) = (parts.next()?, parts.next()?, parts.next()?, parts.next()?);
        let more = parts.next().is_some();
        let whole = hex(version, 2) && hex(trace, 32) && hex(span, 16) && hex(flags, 2);
        if !whole || version == "ff" || (version == "00" && more) {
            return None;
        }
        let parent = Self {
            trace: u128::from_str_radix(trace, 16).ok()?,
            span: u64::from_str_radix(span, 16).ok()?,
            flags: u8::from_str_radix(flags, 16).ok()?,
        };
        (parent.trace != 0 && parent.span != 0).then_some(parent)
    }

    /// The id of the trace, for the log.
    pub fn trace_id(&self) -> String {
        format!("{:032x}", self.trace)
    }

    /// Makes `span` a child of this place. Without a collector nothing happens.
    pub fn adopt(&self, span: &tracing::Span) {
        let context = SpanContext::new(
            TraceId::from(self.trace),
            SpanId::from(self.span),
            TraceFlags::new(self.flags),
            true,
            TraceState::default(),
        );
        let _ = span.set_parent(Context::new().with_remote_span_context(context));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_trace_parent_is_read_as_the_standard_says() {
        let text = "00-4bf92f3577b34da6a3ce929d0e0e4736-00f067aa0ba902b7-01";
        let parent = TraceParent::parse(text).expect("reads");
        assert_eq!(parent.trace_id(), "4bf92f3577b34da6a3ce929d0e0e4736");
        assert_eq!((parent.span, parent.flags), (0x00f0_67aa_0ba9_02b7, 1));
        assert!(TraceParent::parse(&format!("cc{}-more", &text[2..])).is_some(), "later versions may add parts");
        for wrong in [
            "",
            "00",
            &text.to_uppercase(),
            &format!("{text}-more"),
            &format!("ff{}", &text[2..]),
            "00-00000000000000000000000000000000-00f067aa0ba902b7-01",
            "00-4bf92f3577b34da6a3ce929d0e0e4736-0000000000000000-01",
            "00-4bf92f3577b34da6a3ce929d0e0e473-00f067aa0ba902b7-01",
        ] {
            assert_eq!(TraceParent::parse(wrong), None, "{wrong}");
        }
    }

    #[test]
    fn headers_of_the_collector_are_pairs_and_refusals_show_no_value() {
        let collector = Collector::new("http://c:4318/", Some("authorization=Bearer a=b, x-team=rigs")).expect("reads");
        assert_eq!(collector.endpoint, "http://c:4318");
        assert_eq!(collector.headers["authorization"], "Bearer a=b");
        assert_eq!(collector.headers["x-team"], "rigs");
        assert!(Collector::new("http://c", Some("nonsense")).is_err());
    }
}
