//! Object stores: one contract for a directory and for S3, then what only a network can do.

#[cfg(test)]
mod support;

use std::time::Duration;

use plumbline_common::store::{
    Access, DirStore, ObjectStore, S3Options, S3Store, StoreError, fetch, fetch_ends_to_file, probe,
};
use support::faulty_proxy::{Fault, FaultyProxy};
use support::store_contract::{content, keeps_the_contract, key};
use support::{s3, s3_options, server, unique};

#[tokio::test(flavor = "multi_thread")]
async fn a_directory_keeps_the_contract() {
    let dir = tempfile::tempdir().unwrap();
    keeps_the_contract(&DirStore::new(dir.path().join("made/on/demand")), 20 << 20).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn s3_keeps_the_contract() {
    let store = s3("contract", &s3_options()).await;
    // Five parts of an upload, three ranges of a read, neither full at its end.
    keeps_the_contract(&store, (20 << 20) + 1).await;
}

#[tokio::test]
async fn a_directory_refuses_keys_that_leave_it_and_hides_partial_files() {
    let dir = tempfile::tempdir().unwrap();
    let store = DirStore::new(dir.path().join("root"));
    for hostile in [
        "../out",
        "a/../../out",
        "/etc/out",
        "a//b",
        "a/",
        ".x.partial",
    ] {
        let refused = store.put(&key(hostile), content(1)).await;
        assert!(
            matches!(refused, Err(StoreError::Key(_))),
            "{hostile}: {refused:?}"
        );
    }
    assert!(!dir.path().join("out").exists());
    store.put(&key("a"), content(1)).await.unwrap();
    std::fs::write(dir.path().join("root/.a.123.partial"), "x").unwrap();
    let listed: Vec<_> = futures_util::TryStreamExt::try_concat(store.list(""))
        .await
        .unwrap();
    assert_eq!(listed.len(), 1);
}

#[tokio::test]
async fn ends_of_a_part_lie_at_their_places() {
    let dir = tempfile::tempdir().unwrap();
    let store = DirStore::new(dir.path().join("root"));
    let whole = content(10_000);
    store.put(&key("a"), whole.clone()).await.unwrap();
    let meta = store.head(&key("a")).await.unwrap();
    for (number, (range, end_bytes)) in
        [(0..10_000, 100), (500..9_000, 3_000), (7..20, 9), (3..3, 9)]
            .into_iter()
            .enumerate()
    {
        let file = dir.path().join(number.to_string());
        let part = range.start as usize..range.end as usize;
        fetch_ends_to_file(&store, &meta, range, end_bytes, &file)
            .await
            .unwrap();
        let mut expected = whole[part].to_vec();
        let (end, bytes) = (end_bytes as usize, expected.len());
        if end < bytes.saturating_sub(end) {
            expected[end..bytes - end].fill(0);
        }
        assert_eq!(std::fs::read(&file).unwrap(), expected, "{number}");
    }
}

#[tokio::test]
async fn passing_faults_are_outlasted() {
    let upstream = server("PLUMBLINE_TEST_S3_ENDPOINT");
    let proxy = FaultyProxy::before(upstream.replace("http://", "")).await;
    let options = S3Options {
        endpoint: Some(proxy.endpoint()),
        attempt_timeout: Duration::from_secs(5),
        ..s3_options()
    };
    let store = s3("faults", &options).await;
    let put = content(100_000);
    for faults in [
        &[
            Fault::Answer(500, "InternalError"),
            Fault::Answer(503, "SlowDown"),
        ][..],
        &[Fault::Close, Fault::Answer(429, "TooManyRequests")],
    ] {
        proxy.next_faults(faults);
        store.put(&key("x"), put.clone()).await.unwrap();
    }
    let meta = store.head(&key("x")).await.unwrap();
    // Cut in the head of the answer, in its body, and right before its end; then standing still.
    for fault in [
        Fault::CutAfter(10),
        Fault::CutAfter(50_000),
        Fault::CutAfter(100_100),
        Fault::StallAfter(50_000),
    ] {
        proxy.next_faults(&[fault]);
        assert!(
            fetch(&store, &meta, 100_000).await.unwrap() == put,
            "{fault:?}"
        );
    }
    assert_eq!(proxy.left(), 0, "every fault was met");

    proxy.next_faults(&[Fault::Answer(503, "SlowDown"); 5]);
    let given_up = store.head(&key("x")).await.unwrap_err();
    assert!(given_up.is_transient(), "{given_up:?}");
    assert!(
        given_up.to_string().contains("after 5 attempts"),
        "{given_up}"
    );
}

#[tokio::test]
async fn final_refusals_are_told_at_once() {
    let upstream = server("PLUMBLINE_TEST_S3_ENDPOINT");
    let proxy = FaultyProxy::before(upstream.replace("http://", "")).await;
    let options = S3Options {
        endpoint: Some(proxy.endpoint()),
        ..s3_options()
    };
    let store = s3("refused", &options).await;
    proxy.next_faults(&[
        Fault::Answer(403, "AccessDenied"),
        Fault::Answer(503, "SlowDown"),
    ]);
    let denied = store.put(&key("x"), content(1)).await.unwrap_err();
    assert!(matches!(denied, StoreError::Denied { .. }), "{denied:?}");
    assert_eq!(proxy.left(), 1, "no second attempt");

    let bucket = S3Store::connect(&unique("no-bucket"), "", &s3_options())
        .await
        .unwrap();
    let unusable = probe(&bucket, Access::Read).await.unwrap_err();
    assert!(
        matches!(unusable, StoreError::Unusable { .. }),
        "{unusable:?}"
    );
    assert!(unusable.to_string().contains("NoSuchBucket"), "{unusable}");

    let nameless = plumbline_common::store::open("s3:///prefix", &s3_options()).await;
    assert!(
        matches!(nameless, Err(StoreError::Unusable { .. })),
        "{nameless:?}"
    );
}

#[tokio::test]
async fn a_service_out_of_reach_is_told_after_every_attempt() {
    let free = std::net::TcpListener::bind("127.0.0.1:0")
        .unwrap()
        .local_addr()
        .unwrap();
    let options = S3Options {
        endpoint: Some(format!("http://{free}")),
        ..s3_options()
    };
    let error = probe(&s3("nobody", &options).await, Access::Read)
        .await
        .unwrap_err();
    assert!(error.is_transient(), "{error:?}");
}
