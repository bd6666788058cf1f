//! Plumbline: renders clips with exact flow, depth and pose, and known faults.
