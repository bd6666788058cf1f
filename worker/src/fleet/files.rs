//! Which files of this machine a job may name.

use std::path::{Component, Path};

/// Whether `path` lies below `root` (canonical), links followed. What is not there counts by its nearest
/// directory that is, so that a removed video is a row as everywhere.
pub(super) fn is_below(path: &Path, root: &Path) -> bool {
    for ancestor in path.ancestors() {
        let Ok(real) = ancestor.canonicalize() else {
            continue;
        };
        let plain = |part| matches!(part, Component::Normal(_));
        return match path.strip_prefix(ancestor) {
            Ok(missing) => real.starts_with(root) && missing.components().all(plain),
            Err(_) => false,
        };
    }
    false
}

#[cfg(test)]
mod tests {
    use std::fs;
    use std::os::unix::fs::symlink;

    use super::*;

    #[test]
    fn neither_dots_nor_links_lead_out() {
        let dir = tempfile::tempdir().unwrap();
        let dir = dir.path().canonicalize().unwrap();
        let root = dir.join("videos");
        fs::create_dir_all(root.join("a")).unwrap();
        fs::write(root.join("a/in.mp4"), "x").unwrap();
        fs::write(dir.join("secret"), "x").unwrap();
        symlink(dir.join("secret"), root.join("out.mp4")).unwrap();
        symlink(&dir, root.join("up")).unwrap();
        symlink(root.join("a"), dir.join("videos-too")).unwrap();
        symlink(dir.join("nowhere"), root.join("dangling")).unwrap();
        for inside in [
            "videos/a/in.mp4",
            "videos/a/../a/in.mp4",
            "videos/a",
            "videos-too/in.mp4",
            "videos/gone/gone.mp4",
        ] {
            assert!(is_below(&dir.join(inside), &root), "{inside}");
        }
        for outside in [
            "secret",
            "videos/out.mp4",
            "videos/up/secret",
            "videos/../secret",
            "videos/gone/../../secret",
            "videos-other/x",
            "videos/up/gone",
        ] {
            assert!(!is_below(&dir.join(outside), &root), "{outside}");
        }
        assert!(!is_below(Path::new(""), &root));
        assert!(!is_below(Path::new("relative.mp4"), &root));
    }
}
