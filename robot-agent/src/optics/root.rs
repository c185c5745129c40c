//! One root of a function of one variable.

/// The root of a function (value, slope) that is negative left of it and positive right of it, by Newton inside a bracket
/// that halves where Newton leaves it. `start` may lie anywhere. `None` for what is not finite.
pub(crate) fn root(mut low: f64, mut high: f64, start: f64, function: impl Fn(f64) -> (f64, f64)) -> Option<f64> {
    const STEPS: usize = 80;
    let mut x = if start > low && start < high { start } else { 0.5 * (low + high) };
    for _ in 0..STEPS {
        let (value, slope) = function(x);
        if value > 0.0 {
            high = x;
        } else {
            low = x;
        }
        let newton = x - value / slope;
        let next = if newton >= low && newton <= high { newton } else { 0.5 * (low + high) };
        let step = (next - x).abs();
        x = next;
        if step <= 1e-15 * x.abs() {
            break;
        }
    }
    x.is_finite().then_some(x)
}
