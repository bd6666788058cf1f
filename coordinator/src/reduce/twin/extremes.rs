//! The hand-made corpora of the twin: what they hold is listed there.

const TINY: f64 = 5e-324;
const MAX: f64 = f64::MAX;
const LEAST_NORMAL: f64 = f64::MIN_POSITIVE;

fn steps(n: u32, start: f64, step: f64) -> Vec<f64> {
    (0..n).map(|i| start + f64::from(i) * step).collect()
}

fn with(mut values: Vec<f64>, more: &[f64]) -> Vec<f64> {
    values.extend_from_slice(more);
    values
}

/// The hand-made corpora, by name.
pub(super) fn extremes() -> Vec<(&'static str, Vec<f64>)> {
    let up = |x: f64| x.next_up();
    vec![
        ("one value", vec![1.5]),
        ("one zero", vec![0.0]),
        ("one denormal", vec![TINY]),
        ("the largest float alone", vec![MAX]),
        ("two values", vec![1.0, 2.0]),
        ("two values of both signs", vec![-3.0, 7.0]),
        ("two equal values", vec![0.1, 0.1]),
        ("two values one ulp apart", vec![1.0, up(1.0)]),
        ("two ends of the floats", vec![-MAX, MAX]),
        ("two zeros of both signs", vec![0.0, -0.0]),
        ("constant 0.1", vec![0.1; 7]),
        ("constant 0", vec![0.0; 9]),
        ("constant smallest float", vec![-TINY; 3]),
        ("constant largest float", vec![MAX; 5]),
        ("constant 1e300", vec![1e300; 11]),
        ("constant but one ulp", with(vec![0.3; 12], &[up(0.3)])),
        ("three values, two equal", vec![1.0, 1.0, 2.0]),
        ("two values, many of each", with(vec![1.0; 10], &[2.0; 10])),
        (
            "smallest float and 0: sigma below the floats",
            vec![0.0, TINY],
        ),
        (
            "sigma of one and a half smallest floats",
            vec![0.0, 3.0 * TINY],
        ),
        ("four smallest floats", steps(4, 0.0, TINY)),
        ("forty denormal steps", steps(41, 0.0, TINY)),
        (
            "denormals of both signs",
            vec![-3e-320, 1e-321, 2e-320, 5e-324],
        ),
        (
            "denormals below normal floats",
            vec![TINY, 1e-310, LEAST_NORMAL, 3.0 * LEAST_NORMAL],
        ),
        (
            "around the least normal float",
            vec![LEAST_NORMAL.next_down(), LEAST_NORMAL, up(LEAST_NORMAL)],
        ),
        ("a denormal beside one", vec![TINY, 1.0, 2.0]),
        ("1e-300", vec![1e-300, 2e-300, 3.5e-300]),
        ("1e300", vec![1e300, 2e300, 3.5e300]),
        ("1e300 of both signs", vec![-1e300, 1e300, 5e299]),
        ("1e-300 beside 1e300", vec![1e-300, 1e300, 1.0]),
        (
            "an outlier of 1e300 among equals",
            with(vec![0.0; 16], &[1e300]),
        ),
        (
            "an outlier of 1e300 among steps",
            with(steps(20, 0.0, 1.0), &[1e300]),
        ),
        ("an outlier of -1e300", with(steps(20, 0.0, 1.0), &[-1e300])),
        ("an outlier of 1e16", with(steps(20, 0.0, 0.1), &[1e16])),
        (
            "an outlier of 10 sigma",
            with(steps(30, 0.0, 0.01), &[10.0]),
        ),
        (
            "two outliers that cancel",
            with(steps(10, 1.0, 1.0), &[1e300, -1e300]),
        ),
        ("1e15 and eighths", steps(8, 1e15, 0.125)),
        ("1e15 but one eighth", with(vec![1e15; 2], &[1e15 + 0.125])),
        ("-1e15 and eighths", steps(9, -1e15, 0.125)),
        ("1e15 and 1e15 + 1", with(vec![1e15; 20], &[1e15 + 1.0])),
        (
            "1e12 and ten-thousandths",
            steps(25, 1e12, 1.220_703_125e-4),
        ),
        (
            "2^53 and its neighbours",
            vec![
                9_007_199_254_740_991.0,
                9_007_199_254_740_992.0,
                9_007_199_254_740_994.0,
            ],
        ),
        ("1e300 and ulps", vec![1e300, up(1e300), up(up(1e300))]),
        ("cancelling 1e300 leaves 1", vec![1e300, 1.0, -1e300]),
        (
            "cancelling the largest leaves 1e-300",
            vec![MAX, 1e-300, -MAX],
        ),
        ("the sum overflows", vec![MAX, MAX, MAX, MAX / 2.0]),
        (
            "the range overflows",
            vec![-MAX, -1e308, 0.0, 1.0, 1e308, MAX],
        ),
        (
            "the range overflows, mean far off",
            vec![MAX, MAX, MAX, -MAX],
        ),
        ("squares overflow", vec![1e160, 2e160, -3e160, 4e160]),
        ("squares underflow", vec![1e-170, 2e-170, -3e-170, 4e-170]),
        ("squares are denormal", vec![1e-160, 1.5e-160, 2e-160]),
        (
            "values one ulp apart",
            vec![1.0, up(1.0), up(up(1.0)), up(up(up(1.0)))],
        ),
        ("every bin 1/n", steps(30, 0.0, 1.0)),
        ("every bin 1/n, decimal", steps(30, 0.05, 0.1)),
        (
            "every bin 1/n, twice",
            with(steps(30, 0.0, 1.0), &steps(30, 0.0, 1.0)),
        ),
        ("all but one value in one bin", with(vec![1.0; 400], &[2.0])),
        ("one value at each end", with(vec![0.5; 300], &[0.0, 1.0])),
        (
            "powers of two",
            (0..32).map(|i| libm::scalbn(1.0, -1074 + 67 * i)).collect(),
        ),
        (
            "powers of ten",
            (0..60)
                .map(|i| libm::pow(10.0, f64::from(i) * 10.0 - 300.0))
                .collect(),
        ),
        ("decimal fractions", steps(40, 0.1, 0.1)),
        ("thirds", (1..40).map(|i| f64::from(i) / 3.0).collect()),
        (
            "two far clusters",
            with(steps(10, 0.0, 1e-9), &steps(10, 1e9, 1e-6)),
        ),
        ("mean zero", vec![-3.0, -2.0, -1.0, 1.0, 2.0, 3.0]),
        (
            "mean nearly zero",
            vec![-3.0, -2.0, -1.0, 1.0, 2.0, up(3.0)],
        ),
        ("a value at the mean", vec![1.0, 2.0, 3.0]),
        ("a value one ulp from the mean", vec![1.0, up(2.0), 3.0]),
    ]
}
