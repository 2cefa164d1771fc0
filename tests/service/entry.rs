//! Nobody enters.

use std::fs;
use std::os::unix::fs::symlink;

use areoid_cache::service::{Service, ServiceError};
use serde_json::json;

use super::rig::{
    EQUIRECTANGULAR, Place, Serving, TOKEN, ask, eventually, globe, raster, rest, write_bare,
};

#[test]
fn a_change_without_a_token_is_refused() {
    let serving = Serving::new();
    let body = serving.place.insertion("new", json!({}));
    assert_eq!(ask(serving.admin(), "POST", "/v1/datasets", &[], &body).status, 401);
    assert_eq!(ask(serving.admin(), "DELETE", "/v1/datasets/pole", &[], "").status, 401);
    assert_eq!(serving.names(), ["pole"]);
}

#[test]
fn a_wrong_token_is_refused() {
    let serving = Serving::new();
    let body = serving.place.insertion("new", json!({}));
    let longer = format!("Bearer {TOKEN}x");
    let shorter = format!("Bearer {}", &TOKEN[1..]);
    let other = format!("Bearer {}", TOKEN.replace('o', "0"));
    let basic = format!("Basic {TOKEN}");
    for given in [&longer, &shorter, &other, &basic, "Bearer ", "Bearer", "", TOKEN] {
        let headers = [("authorization", given)];
        assert_eq!(
            ask(serving.admin(), "POST", "/v1/datasets", &headers, &body).status,
            401,
            "{given}"
        );
        assert_eq!(
            ask(serving.admin(), "DELETE", "/v1/datasets/pole", &headers, "").status,
            401,
            "{given}"
        );
    }
    assert_eq!(serving.names(), ["pole"]);
}

#[test]
fn without_a_configured_token_nobody_changes_anything() {
    let serving = Serving::with(|options| options.admin.as_mut().unwrap().token_file = None);
    let body = serving.place.insertion("new", json!({}));
    assert_eq!(serving.insert(&body).status, 403);
    assert_eq!(serving.remove("pole").status, 403);
    assert_eq!(
        ask(serving.admin(), "DELETE", "/v1/datasets/pole", &[("authorization", "Bearer ")], "")
            .status,
        403
    );
    assert_eq!(serving.names(), ["pole"]);
}

#[test]
fn a_raster_outside_the_allowed_folders_is_refused() {
    let serving = Serving::new();
    fs::copy(raster(), serving.place.path("secret.tif")).unwrap();
    fs::create_dir(serving.place.path("rasters-of-others")).unwrap();
    fs::copy(raster(), serving.place.path("rasters-of-others/pole.tif")).unwrap();
    let outside = [
        serving.place.path("secret.tif"),
        serving.place.path("rasters/../secret.tif"),
        serving.place.path("rasters-of-others/pole.tif"),
        serving.place.path("rasters/nobody.tif"),
        serving.place.path("rasters"),
        "pole.tif".into(),
        "/etc/passwd".into(),
    ];
    for path in outside {
        let body = serving.place.insertion("new", json!({ "rasters": [path] }));
        assert_eq!(serving.insert(&body).status, 403, "{}", path.display());
    }
    let within = serving.place.path("rasters/../rasters/pole.tif");
    let both = json!({ "rasters": [within, serving.place.path("secret.tif")] });
    assert_eq!(serving.insert(&serving.place.insertion("new", both)).status, 403);
    assert_eq!(serving.names(), ["pole"]);
    let body = serving.place.insertion("new", json!({ "rasters": [within] }));
    assert_eq!(serving.insert(&body).status, 200);
    assert_eq!(serving.names(), ["new", "pole"]);
}

#[test]
fn a_symbolic_link_does_not_lead_out() {
    let serving = Serving::new();
    let secret = serving.place.path("secret");
    fs::create_dir(&secret).unwrap();
    fs::copy(raster(), secret.join("pole.tif")).unwrap();
    symlink(secret.join("pole.tif"), serving.place.path("rasters/link.tif")).unwrap();
    symlink(&secret, serving.place.path("rasters/link")).unwrap();
    for link in ["rasters/link.tif", "rasters/link/pole.tif"] {
        let body = serving.place.insertion("new", json!({ "rasters": [serving.place.path(link)] }));
        assert_eq!(serving.insert(&body).status, 403, "{link}");
    }
    assert_eq!(serving.names(), ["pole"]);
}

/// Checked when it was asked for, a raster was another file by the time that it was opened. When it
/// is opened depends on the machine: one that is open already is refused for being exchanged.
#[test]
fn a_raster_that_is_exchanged_while_it_waits_is_refused() {
    let serving = Serving::new();
    fs::copy(raster(), serving.place.path("secret.tif")).unwrap();
    let was_waiting = (0..5).any(|attempt| {
        let answer = exchange_while_it_waits(&serving, attempt);
        assert!(!serving.names().contains(&format!("victim{attempt}")), "{answer}");
        let in_time = answer.contains("not in an allowed folder");
        assert!(in_time || answer.contains("was modified while it was read"), "{answer}");
        in_time
    });
    assert!(was_waiting);
}

/// The answer to an insertion whose raster becomes a link that leads out while a large one keeps it
/// waiting.
fn exchange_while_it_waits(serving: &Serving, attempt: usize) -> String {
    let place = &serving.place;
    let victim = place.path(&format!("rasters/victim{attempt}.tif"));
    fs::copy(raster(), &victim).unwrap();
    let large = place.path("rasters/large.tif");
    write_bare(&large, 4096, 2048);
    let mut named = globe();
    named["rasters"] = json!([large]);
    let before = serving.begin_to_insert(&place.insertion(&format!("large{attempt}"), named));
    eventually("it is admitted", || serving.metric("areoid_inserting") >= 1.0);
    let named = json!({ "rasters": [victim] });
    let stream = serving.begin_to_insert(&place.insertion(&format!("victim{attempt}"), named));
    let (begun, ended) = ("areoid_inserting", "areoid_inserted_total");
    let all = (attempt + 2) as f64;
    eventually("both are", || serving.metric(begun) + serving.metric(ended) >= all);
    fs::remove_file(&victim).unwrap();
    symlink(place.path("secret.tif"), &victim).unwrap();
    assert!(rest(before).unwrap().text().contains("inserted"));
    rest(stream).unwrap().text()
}

#[test]
fn what_lies_beside_a_raster_does_not_lead_out() {
    let serving = Serving::new();
    let place = &serving.place;
    write_bare(&place.path("rasters/bare.tif"), 64, 32);
    let named = json!({ "rasters": [place.path("rasters/bare.tif")] });
    let with = |more: serde_json::Value| {
        let mut all = named.clone();
        all.as_object_mut().unwrap().extend(more.as_object().unwrap().clone());
        place.insertion("bare", all)
    };
    let cases = [
        ("tfw", "1000\n0\n0\n-1000\n500\n-500\n", json!({ "crs": EQUIRECTANGULAR })),
        ("prj", EQUIRECTANGULAR, json!({ "extent": [0, -32000, 64000, 0] })),
    ];
    for (kind, text, more) in cases {
        let (secret, beside) =
            (place.path("secret"), place.path("rasters/bare").with_extension(kind));
        fs::write(&secret, text).unwrap();
        symlink(&secret, &beside).unwrap();
        let refused = serving.insert(&with(more.clone())).text();
        assert!(refused.contains("not in an allowed folder"), "{kind}: {refused}");
        assert_eq!(serving.names(), ["pole"], "{kind}");
        fs::remove_file(&beside).unwrap();
        fs::copy(&secret, &beside).unwrap();
        let inserted = serving.insert(&with(more)).text();
        assert!(inserted.contains("inserted"), "{kind}: {inserted}");
        assert_eq!(serving.remove("bare").status, 200);
        fs::remove_file(&beside).unwrap();
    }
}

#[test]
fn a_dataset_is_not_named_out_of_the_catalog() {
    let serving = Serving::new();
    for name in ["../x", "..", "a/b", "/tmp/x", ".hidden", "", "x\0y", "%2e%2e%2fx"] {
        for temporary in [false, true] {
            let body = serving.place.insertion(name, json!({ "temporary": temporary }));
            let answer = serving.insert(&body);
            assert_eq!(answer.status, 400, "{name:?}");
            assert!(answer.text().contains("cannot name a dataset"), "{name:?}: {}", answer.text());
        }
    }
    assert_eq!(serving.remove("../x").status, 404);
    assert_eq!(serving.remove("..%2f..%2fx").status, 404);
    assert!(!serving.place.path("x").exists());
    assert_eq!(serving.names(), ["pole"]);
}

#[test]
fn a_body_that_is_too_large_or_makes_no_sense_is_refused() {
    let serving = Serving::new();
    assert_eq!(serving.insert(&" ".repeat(100 << 10)).status, 413);
    let file = serving.place.path("token");
    for (body, status) in [
        (String::new(), 400),
        ("{".to_owned(), 400),
        ("{\"rasters\": []}".to_owned(), 400),
        (serving.place.insertion("new", json!({ "catalog": "/tmp" })), 400),
        (serving.place.insertion("new", json!({ "page_size": 7 })), 400),
        (serving.place.insertion("new", json!({ "threads": 1_000_000 })), 400),
        (serving.place.insertion("new", json!({ "kernel": "magic" })), 400),
        (serving.place.insertion("new", json!({ "crs": file })), 403),
    ] {
        assert_eq!(serving.insert(&body).status, status, "{body}");
    }
    assert_eq!(serving.names(), ["pole"]);
}

#[test]
fn an_admin_listener_beyond_the_loopback_needs_a_token() {
    let place = Place::new();
    let mut options = place.options();
    let admin = options.admin.as_mut().unwrap();
    admin.listen = "0.0.0.0:0".parse().unwrap();
    admin.token_file = None;
    let refused = Service::start(&options).unwrap_err();
    assert!(matches!(refused, ServiceError::Exposed { .. }), "{refused}");
    options.admin.as_mut().unwrap().token_file = Some(place.path("token"));
    Service::start(&options).unwrap().stop();
    fs::write(place.path("token"), "short\n").unwrap();
    assert!(matches!(Service::start(&options).unwrap_err(), ServiceError::Token { .. }));
}
