//! The camera of a listed video: its columns `fx`, `fy`, `cx`, `cy`, in pixels of the video as decoded.
//! A list without all four columns says nothing of cameras, nor does a row in which all four are empty.

use plumbline_vision::slam::intrinsics::Intrinsics;
use serde_json::{Map, Value};

const COLUMNS: [&str; 4] = ["fx", "fy", "cx", "cy"];

/// The intrinsics of a row.
///
/// # Errors
/// What is wrong with the row's columns, and the remedy.
pub(super) fn intrinsics(carried: &Map<String, Value>) -> Result<Option<Intrinsics>, String> {
    let cells = COLUMNS.map(|column| carried.get(column));
    let [Some(fx), Some(fy), Some(cx), Some(cy)] = cells else {
        return Ok(None);
    };
    let cells = [fx, fy, cx, cy];
    if cells.iter().all(|cell| cell.is_null()) {
        return Ok(None);
    }
    let numbers = cells.map(|cell| match cell {
        Value::String(text) => text.trim().parse().ok(),
        other => other.as_f64(),
    });
    let [Some(fx), Some(fy), Some(cx), Some(cy)] = numbers else {
        return Err("the columns fx, fy, cx and cy must hold four numbers, or nothing".to_owned());
    };
    let intrinsics = Intrinsics { fx, fy, cx, cy };
    match intrinsics.is_valid() {
        true => Ok(Some(intrinsics)),
        false => Err("fx and fy must be above 0, and all of fx, fy, cx, cy finite".to_owned()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(row: &str) -> Result<Option<Intrinsics>, String> {
        intrinsics(&serde_json::from_str(row).unwrap())
    }

    #[test]
    fn four_numbers_or_nothing() {
        let camera = Intrinsics {
            fx: 585.0,
            fy: 584.5,
            cx: 320.0,
            cy: 240.0,
        };
        for row in [
            r#"{"fx":585,"fy":584.5,"cx":320,"cy":240,"task":"pick"}"#,
            r#"{"fx":"585","fy":" 584.5","cx":"320","cy":"240"}"#,
        ] {
            assert_eq!(of(row).unwrap(), Some(camera), "{row}");
        }
        for row in [
            "{}",
            r#"{"cx":7}"#,
            r#"{"fx":null,"fy":null,"cx":null,"cy":null}"#,
        ] {
            assert_eq!(of(row).unwrap(), None, "{row}");
        }
        for row in [
            r#"{"fx":585,"fy":null,"cx":320,"cy":240}"#,
            r#"{"fx":"wide","fy":1,"cx":320,"cy":240}"#,
            r#"{"fx":0,"fy":1,"cx":320,"cy":240}"#,
            r#"{"fx":"inf","fy":1,"cx":320,"cy":240}"#,
        ] {
            assert!(of(row).unwrap_err().contains("fx"), "{row}");
        }
    }
}
