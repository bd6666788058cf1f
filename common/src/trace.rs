//! Which trace a piece of work belongs to, as the W3C's `traceparent` header says it:
//! `00-TRACE-SPAN-FLAGS` in lower-case hexadecimal (<https://www.w3.org/TR/trace-context/>).

use rand::RngExt;

/// One span of a trace.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct TraceContext {
    trace: u128,
    span: u64,
    flags: u8,
}

/// Whoever begins a trace asks for it to be kept.
const SAMPLED: u8 = 1;

impl TraceContext {
    /// Begins a trace.
    #[must_use]
    pub fn root() -> Self {
        let mut rng = rand::rng();
        Self {
            trace: rng.random_range(1..=u128::MAX),
            span: rng.random_range(1..=u64::MAX),
            flags: SAMPLED,
        }
    }

    /// Reads a header; `None` where it is none, or of a version that begins otherwise.
    #[must_use]
    pub fn parse(traceparent: &str) -> Option<Self> {
        let mut parts = traceparent.split('-');
        let mut next = |digits: usize| {
            let part = parts.next()?;
            let lower_hex = |byte| matches!(byte, b'0'..=b'9' | b'a'..=b'f');
            (part.len() == digits && part.bytes().all(lower_hex)).then_some(part)
        };
        let (version, trace, span, flags) = (next(2)?, next(32)?, next(16)?, next(2)?);
        // A later version may have more parts behind these; this one has not.
        if version == "ff" || version == "00" && parts.next().is_some() {
            return None;
        }
        let context = Self {
            trace: u128::from_str_radix(trace, 16).ok()?,
            span: u64::from_str_radix(span, 16).ok()?,
            flags: u8::from_str_radix(flags, 16).ok()?,
        };
        (context.trace != 0 && context.span != 0).then_some(context)
    }

    /// A new span of the same trace.
    #[must_use]
    pub fn child(self) -> Self {
        Self {
            span: rand::rng().random_range(1..=u64::MAX),
            ..self
        }
    }

    /// The trace, in hexadecimal.
    #[must_use]
    pub fn trace_id(self) -> String {
        format!("{:032x}", self.trace)
    }

    /// The span, in hexadecimal.
    #[must_use]
    pub fn span_id(self) -> String {
        format!("{:016x}", self.span)
    }
}

/// The header.
impl std::fmt::Display for TraceContext {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(
            f,
            "00-{:032x}-{:016x}-{:02x}",
            self.trace, self.span, self.flags
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The example of the recommendation.
    const EXAMPLE: &str = "00-0af7651916cd43dd8448eb211c80319c-b7ad6b7169203331-01";

    #[test]
    fn a_header_survives_and_its_children_stay_in_the_trace() {
        let parent = TraceContext::parse(EXAMPLE).unwrap();
        assert_eq!(parent.to_string(), EXAMPLE);
        assert_eq!(parent.span_id(), "b7ad6b7169203331");
        let child = parent.child();
        assert_eq!(child.trace_id(), "0af7651916cd43dd8448eb211c80319c");
        assert_ne!(child.span_id(), parent.span_id());
        let root = TraceContext::root();
        assert_eq!(TraceContext::parse(&root.to_string()), Some(root));
        let later = EXAMPLE.replacen("00", "01", 1) + "-more";
        assert_eq!(TraceContext::parse(&later), Some(parent));
    }

    #[test]
    fn what_is_no_header_is_none() {
        let zeros = "00-00000000000000000000000000000000-b7ad6b7169203331-01";
        let upper = EXAMPLE.to_uppercase();
        let longer = format!("{EXAMPLE}-x");
        let invalid_version = EXAMPLE.replacen("00", "ff", 1);
        for text in [
            "",
            "00",
            zeros,
            &upper,
            &longer,
            &invalid_version,
            &EXAMPLE[..54],
        ] {
            assert_eq!(TraceContext::parse(text), None, "{text}");
        }
    }
}
