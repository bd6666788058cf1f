//! What every object store promises, asked of each in the same words.

use std::collections::BTreeSet;

use bytes::Bytes;
use futures_util::{StreamExt, TryStreamExt, stream};
use plumbline_common::store::{
    Access, ObjectKey, ObjectMeta, ObjectStore, PAGE_OBJECTS, StoreError, fetch, fetch_to_file,
    probe,
};

pub(crate) fn key(name: &str) -> ObjectKey {
    ObjectKey::new(name).unwrap()
}

/// Bytes that repeat with no power of two, so that a shifted range is noticed.
pub(crate) fn content(bytes: usize) -> Bytes {
    (0..bytes).map(|k| (k % 251) as u8).collect()
}

async fn names(store: &dyn ObjectStore, prefix: &str) -> Vec<String> {
    let pages: Vec<Vec<ObjectMeta>> = store.list(prefix).try_collect().await.unwrap();
    assert!(pages.iter().all(|page| page.len() <= PAGE_OBJECTS));
    let objects = pages.into_iter().flatten();
    objects.map(|object| object.key.to_string()).collect()
}

/// Asks for all of it, one after the other, of an empty store. `large` is more than one part of an
/// upload and more than one range of a read.
pub(crate) async fn keeps_the_contract(store: &dyn ObjectStore, large: usize) {
    assert_eq!(names(store, "").await, [""; 0]);
    probe(store, Access::ReadWrite).await.unwrap();
    assert_eq!(names(store, "").await, [""; 0], "a probe leaves nothing");
    what_was_put_comes_back(store).await;
    ranges_are_exact(store).await;
    large_files_travel_whole(store, large).await;
    what_is_not_there_is_not_found(store).await;
    a_changed_object_is_told(store).await;
    sizes_are_limited_before_the_first_byte(store).await;
    long_listings_are_whole_and_in_order(store).await;
}

async fn what_was_put_comes_back(store: &dyn ObjectStore) {
    let keys = ["a", "sub/b.mp4", "with space/ünï+%2F&?#=.txt"];
    for (n, name) in keys.iter().enumerate() {
        for bytes in [n * 1000, n * 1000 + 1] {
            let put = content(bytes);
            store.put(&key(name), put.clone()).await.unwrap();
            // Putting it again changes nothing.
            store.put(&key(name), put.clone()).await.unwrap();
            let meta = store.head(&key(name)).await.unwrap();
            assert_eq!((meta.bytes, &meta.key), (bytes as u64, &key(name)));
            assert_eq!(fetch(store, &meta, bytes as u64).await.unwrap(), put);
        }
    }
    let listed: Vec<_> = store.list("sub/").try_concat().await.unwrap();
    assert_eq!(listed.len(), 1);
    assert!(listed[0].is_same_version(&store.head(&key("sub/b.mp4")).await.unwrap()));
    // A prefix is one of bytes, not of directories.
    assert_eq!(names(store, "su").await, ["sub/b.mp4"]);
    assert_eq!(names(store, "nothing/here").await, [""; 0]);
    for name in keys {
        store.delete(&key(name)).await.unwrap();
        store.delete(&key(name)).await.unwrap();
    }
    assert_eq!(names(store, "").await, [""; 0]);
}

async fn ranges_are_exact(store: &dyn ObjectStore) {
    let put = content(1000);
    store.put(&key("ranges"), put.clone()).await.unwrap();
    let meta = store.head(&key("ranges")).await.unwrap();
    for range in [0..1, 0..1000, 17..19, 999..1000] {
        let read = store.get_range(&meta, range.clone()).await.unwrap();
        assert_eq!(
            read,
            put[range.start as usize..range.end as usize],
            "{range:?}"
        );
    }
    store.delete(&key("ranges")).await.unwrap();
}

async fn large_files_travel_whole(store: &dyn ObjectStore, large: usize) {
    let dir = tempfile::tempdir().unwrap();
    for bytes in [0, 1, large] {
        let (source, sink) = (dir.path().join("in"), dir.path().join("out"));
        std::fs::write(&source, content(bytes)).unwrap();
        store.put_file(&key("large"), &source).await.unwrap();
        let meta = store.head(&key("large")).await.unwrap();
        assert_eq!(meta.bytes, bytes as u64);
        fetch_to_file(store, &meta, bytes as u64, &sink)
            .await
            .unwrap();
        assert!(
            std::fs::read(&sink).unwrap() == content(bytes),
            "{bytes} bytes differ"
        );
        std::fs::remove_file(sink).unwrap();
    }
    store.delete(&key("large")).await.unwrap();
    let unreadable = store
        .put_file(&key("large"), &dir.path().join("none"))
        .await;
    assert!(unreadable.unwrap_err().to_string().contains("none"));
}

async fn what_is_not_there_is_not_found(store: &dyn ObjectStore) {
    let missing = store.head(&key("not/there")).await;
    assert!(
        matches!(missing, Err(StoreError::NotFound { .. })),
        "{missing:?}"
    );
    let meta = ObjectMeta {
        key: key("not/there"),
        bytes: 1,
        etag: None,
        modified_s: None,
    };
    let missing = store.get_range(&meta, 0..1).await;
    let error = missing.unwrap_err();
    assert!(matches!(error, StoreError::NotFound { .. }), "{error:?}");
    assert!(error.to_string().contains("not/there"));
}

async fn a_changed_object_is_told(store: &dyn ObjectStore) {
    let name = key("changed");
    store.put(&name, content(100)).await.unwrap();
    let listed = store.head(&name).await.unwrap();
    for other in [content(101), content(50), Bytes::from(vec![1; 100])] {
        store.put(&name, other).await.unwrap();
        let read = fetch(store, &listed, 100).await;
        assert!(matches!(read, Err(StoreError::Changed { .. })), "{read:?}");
        // Beyond the end of what is there now, too.
        let read = store.get_range(&listed, 99..100).await;
        assert!(matches!(read, Err(StoreError::Changed { .. })), "{read:?}");
    }
    store.delete(&name).await.unwrap();
}

async fn sizes_are_limited_before_the_first_byte(store: &dyn ObjectStore) {
    let meta = ObjectMeta {
        key: key("not/asked/for"),
        bytes: 101,
        etag: None,
        modified_s: None,
    };
    let refused = fetch(store, &meta, 100).await;
    assert!(
        matches!(
            refused,
            Err(StoreError::TooLarge {
                bytes: 101,
                limit: 100,
                ..
            })
        ),
        "{refused:?}"
    );
}

async fn long_listings_are_whole_and_in_order(store: &dyn ObjectStore) {
    // `x.` and `x/` sort by bytes, whatever a directory walk would give.
    let expected: BTreeSet<String> = (0..PAGE_OBJECTS + 234)
        .map(|k| format!("many/{}x{}{k:05}", k % 7, ["/", ".", "-"][k % 3]))
        .collect();
    stream::iter(&expected)
        .for_each_concurrent(16, async |name| {
            store
                .put(&key(name), Bytes::from_static(b"x"))
                .await
                .unwrap();
        })
        .await;
    assert!(names(store, "many/").await.iter().eq(&expected));
    let some = names(store, "many/3x.").await;
    assert!(
        some.iter()
            .eq(expected.iter().filter(|name| name.starts_with("many/3x.")))
    );
    assert!(!some.is_empty());
}
