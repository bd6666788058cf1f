//! Where a video is as seen from the report: a relative address, so that the page plays it from a disk
//! and from a bucket alike. None where there is no way from one to the other.

use std::fmt::Write as _;
use std::os::unix::ffi::OsStrExt;
use std::path::Path;

use plumbline_common::message::Location;

/// Where the report is.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Viewpoint {
    /// The bucket, where it is in one.
    bucket: Option<String>,
    /// The parts of its directory's path or prefix.
    directory: Vec<Vec<u8>>,
}

impl Viewpoint {
    /// Of a report in OUT, a directory or `s3://bucket/prefix`.
    #[must_use]
    pub fn of(out: &str) -> Self {
        if let Some(address) = out.strip_prefix("s3://") {
            let (bucket, prefix) = address.split_once('/').unwrap_or((address, ""));
            return Self {
                bucket: Some(bucket.to_owned()),
                directory: parts(prefix.as_bytes()),
            };
        }
        let path = Path::new(out);
        let absolute = path.canonicalize().or_else(|_| std::path::absolute(path));
        let absolute = absolute.unwrap_or_else(|_| path.to_path_buf());
        Self {
            bucket: None,
            directory: parts(absolute.as_os_str().as_bytes()),
        }
    }

    /// The address of a video.
    #[must_use]
    pub fn address(&self, location: &Location) -> Option<String> {
        let target = match (location, &self.bucket) {
            (Location::File(path), None) => parts(path),
            (Location::Object(object), Some(bucket)) if object.bucket == *bucket => {
                parts(object.key.as_bytes())
            }
            _ => return None,
        };
        let pairs = self.directory.iter().zip(&target);
        let common = pairs.take_while(|(a, b)| a == b).count();
        let mut address = "../".repeat(self.directory.len() - common);
        for (index, part) in target.iter().skip(common).enumerate() {
            if index > 0 {
                address.push('/');
            }
            encode(part, &mut address);
        }
        Some(address)
    }
}

fn parts(path: &[u8]) -> Vec<Vec<u8>> {
    let parts = path
        .split(|byte| *byte == b'/')
        .filter(|part| !part.is_empty());
    parts.map(<[u8]>::to_vec).collect()
}

/// As RFC 3986 has a path's segment; a colon, too, since a first segment must not look like a scheme.
fn encode(part: &[u8], address: &mut String) {
    for &byte in part {
        if byte.is_ascii_alphanumeric() || b"-._~!$&'()*+,;=@".contains(&byte) {
            address.push(char::from(byte));
        } else {
            // Writing to a string cannot fail.
            let _ = write!(address, "%{byte:02X}");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use plumbline_common::message::ObjectLocation;

    #[test]
    fn addresses_lead_from_the_report_to_the_video() {
        let at = Viewpoint {
            bucket: None,
            directory: parts(b"/data/out/run"),
        };
        let file = |path: &[u8]| at.address(&Location::File(path.to_vec())).unwrap();
        assert_eq!(
            file(b"/data/videos/a b#1?.mp4"),
            "../../videos/a%20b%231%3F.mp4"
        );
        assert_eq!(
            file(b"/data/out/run/javascript:x.mp4"),
            "javascript%3Ax.mp4"
        );
        assert_eq!(file(b"/data/out/run/\xff.mp4"), "%FF.mp4");
        assert_eq!(
            at.address(&Location::ImageSequence(b"/data/x".to_vec())),
            None
        );
        let object = |bucket: &str| {
            Location::Object(ObjectLocation {
                bucket: bucket.to_owned(),
                key: "rollouts/a.mp4".to_owned(),
                etag: None,
                modified_s: None,
            })
        };
        let stored = Viewpoint::of("s3://bucket/out/run/");
        assert_eq!(
            stored.address(&object("bucket")).unwrap(),
            "../../rollouts/a.mp4"
        );
        assert_eq!(stored.address(&object("another")), None);
        assert_eq!(at.address(&object("bucket")), None);
    }
}
