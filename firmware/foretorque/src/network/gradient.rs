use super::{Activation, BpNetwork, loaded, opaque, unset};
use core::array;
use nalgebra::{SMatrix, SVector};

/// How an incremental step is taken.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StepParameters {
    /// Step length as a fraction of the step that would cancel the error of this sample; stable below 2, useful below
    /// 0.1.
    pub learning_rate: f32,
    /// Bound of each output's error, in units of the output. An outlier moves the weights no further than this.
    pub error_clip: f32,
}

/// Errors carried back through the network, in sums.
struct Deltas {
    /// `Σ_h slope(a_h)² |W2_h|²`: how far the outputs move with the inputs of the hidden units.
    sensitivity: f32,
    /// `|a|²`.
    power: f32,
    /// Sum of the deltas at the inputs of the hidden units: finite only if each is.
    sum: f32,
}

impl<const I: usize, const H: usize, const O: usize, A: Activation> BpNetwork<I, H, O, A> {
    /// One incremental step of gradient descent (eq. 21) on the squared error of one sample, normalised and clipped.
    ///
    /// ```text
    /// e = clip(y − target)         w ← w − learning_rate · dJ/dw / (1 + G)         J = ½ |y − target|²
    /// d2 = e                       dJ/dW2 = d2 aᵀ    dJ/db2 = d2
    /// d1 = (W2ᵀ d2) ∘ slope(a)     dJ/dW1 = d1 xᵀ    dJ/db1 = d1
    /// G = 1 + |a|² + (1 + |x|²) Σ_h slope(a_h)² |W2_h|²   ≥ |∂y/∂w|²
    /// ```
    ///
    /// The paper's loss is `RMSE = sqrt(mean (τ − τ̂)²)` (eq. 20) over all samples: its gradient is the mean of these
    /// gradients divided by the RMSE, so a descent on either goes the same way with another rate.
    ///
    /// `G` bounds the squared norm of the output's sensitivity to all weights (exact for one output), so the change of
    /// the output is at most `learning_rate · e` and the change of the weights at most `learning_rate · |e| / 2`,
    /// whatever the inputs. It comes from the vectors at hand: gradients are outer products and are never formed.
    ///
    /// * returns the error `y − target` before the step, unclipped. If it is not finite, nothing changes.
    ///
    /// Cost: forward pass, and `2 I H + 4 H O` multiply-adds.
    #[inline]
    pub fn update(
        &mut self,
        x: &SVector<f32, I>,
        target: &SVector<f32, O>,
        step: &StepParameters,
    ) -> SVector<f32, O> {
        let mut a = unset();
        self.hidden_into(x, &mut a);
        let error = self.output(&a) - target;
        let clipped = error.map(|e| clip(e, step.error_clip));
        let mut delta = unset();
        if let Some(rate) = self.rate(x, &a, &clipped, step, &mut delta) {
            let (weights, bias) = (&mut self.output_weights, &mut self.output_bias);
            descend(weights, bias, &a, &clipped, rate);
            let (weights, bias) = (&mut self.hidden_weights, &mut self.hidden_bias);
            descend(weights, bias, x, &delta, rate);
        }
        error
    }

    /// The hidden layer's part of an [`update`](Self::update): hidden outputs `a`, error `y − target`.
    #[inline]
    pub fn update_hidden(
        &mut self,
        x: &SVector<f32, I>,
        a: &SVector<f32, H>,
        error: &SVector<f32, O>,
        step: &StepParameters,
    ) {
        let clipped = error.map(|e| clip(e, step.error_clip));
        let mut delta = unset();
        if let Some(rate) = self.rate(x, a, &clipped, step, &mut delta) {
            let (weights, bias) = (&mut self.hidden_weights, &mut self.hidden_bias);
            descend(weights, bias, x, &delta, rate);
        }
    }

    /// Rate of a step for the `clipped` errors, and `delta`, the deltas at the inputs of the hidden units; `None` where a
    /// factor of the step is not finite.
    #[inline(always)]
    fn rate(
        &self,
        x: &SVector<f32, I>,
        a: &SVector<f32, H>,
        clipped: &SVector<f32, O>,
        step: &StepParameters,
        delta: &mut SVector<f32, H>,
    ) -> Option<f32> {
        let deltas = self.propagate_back(a, clipped, delta);
        let sensitivity = 1.0 + deltas.power + (1.0 + squared(x)) * deltas.sensitivity;
        let rate = step.learning_rate / (1.0 + sensitivity);
        // A sum of the step's factors is finite only if each is; the weights are touched after that, never before.
        let probe = 0.0 * (rate + deltas.sum + sum(clipped) + squared(x));
        (probe == 0.0).then_some(rate)
    }

    /// Carries output errors `output` back to `hidden`, the deltas at the inputs of the hidden units, where the hidden
    /// outputs are `a`.
    #[inline]
    fn propagate_back(
        &self,
        a: &SVector<f32, H>,
        output: &SVector<f32, O>,
        hidden: &mut SVector<f32, H>,
    ) -> Deltas {
        let errors: &[f32; O] = &output.data.0[0];
        let mut deltas = Deltas {
            sensitivity: 0.0,
            power: 0.0,
            sum: 0.0,
        };
        let (pairs, last) = self.output_weights.data.0.as_chunks::<2>();
        let (a_pairs, a_last) = a.as_slice().as_chunks::<2>();
        let (hidden_pairs, hidden_last) = hidden.as_mut_slice().as_chunks_mut::<2>();
        for ((&[one, two], &[a_one, a_two]), hidden) in pairs.iter().zip(a_pairs).zip(hidden_pairs)
        {
            loaded(O * H);
            *hidden = [
                deltas.of_unit::<A, O>(&one, errors, a_one),
                deltas.of_unit::<A, O>(&two, errors, a_two),
            ];
        }
        for ((weights, &a), hidden) in last.iter().zip(a_last).zip(hidden_last) {
            *hidden = deltas.of_unit::<A, O>(weights, errors, a);
        }
        deltas
    }
}

impl Deltas {
    /// The delta of the hidden unit whose output is `a`, from the `errors` of the outputs it leads to.
    #[inline(always)]
    fn of_unit<A: Activation, const O: usize>(
        &mut self,
        weights: &[f32; O],
        errors: &[f32; O],
        a: f32,
    ) -> f32 {
        let slope = A::slope(a);
        let delta = slope * dot(weights, errors);
        self.sensitivity += slope * slope * dot(weights, weights);
        self.power += a * a;
        self.sum += delta;
        delta
    }
}

/// `Σ a b`, from the first product on.
#[inline(always)]
fn dot<const L: usize>(a: &[f32; L], b: &[f32; L]) -> f32 {
    let mut products = a.iter().zip(b).map(|(a, b)| a * b);
    let first = products.next().unwrap_or(0.0);
    products.fold(first, |sum, product| sum + product)
}

/// `value` cut to ±`bound`. Not `f32::clamp`, which panics when the bound is not a number.
#[inline(always)]
fn clip(value: f32, bound: f32) -> f32 {
    if value > bound {
        bound
    } else if value < -bound {
        -bound
    } else {
        value
    }
}

#[inline(always)]
fn squared<const R: usize>(v: &SVector<f32, R>) -> f32 {
    let (sixes, rest) = v.as_slice().as_chunks::<6>();
    let mut sum = 0.0;
    for v in sixes {
        for v in v {
            sum += v * v;
        }
    }
    for v in rest {
        sum += v * v;
    }
    sum
}

#[inline(always)]
fn sum<const R: usize>(v: &SVector<f32, R>) -> f32 {
    v.as_slice().iter().sum()
}

/// `W ← W − rate · delta sourceᵀ` and `b ← b − rate · delta`, in blocks of eight and six rows whose deltas stay in registers
/// while the columns go by.
#[inline]
fn descend<const R: usize, const C: usize>(
    weights: &mut SMatrix<f32, R, C>,
    bias: &mut SVector<f32, R>,
    source: &SVector<f32, C>,
    delta: &SVector<f32, R>,
    rate: f32,
) {
    let columns = opaque(&mut weights.data.0, R * C);
    let source: &[f32; C] = opaque(&source.data.0[0], R * C);
    let (eights, rest) = delta.as_slice().as_chunks::<8>();
    let (bias_eights, bias_rest) = bias.as_mut_slice().as_chunks_mut::<8>();
    for (index, (delta, bias)) in eights.iter().zip(bias_eights).enumerate() {
        descend_block(columns, bias, source, delta, rate, |column| {
            column.as_chunks_mut::<8>().0.get_mut(index)
        });
    }
    let (sixes, rest) = rest.as_chunks::<6>();
    let (bias_sixes, bias_rest) = bias_rest.as_chunks_mut::<6>();
    for (delta, bias) in sixes.iter().zip(bias_sixes) {
        descend_block(columns, bias, source, delta, rate, |column| {
            column.as_chunks_mut::<8>().1.first_chunk_mut()
        });
    }
    let from = R - rest.len();
    for (row, (delta, bias)) in rest.iter().zip(bias_rest).enumerate() {
        descend_block(
            columns,
            array::from_mut(bias),
            source,
            &[*delta],
            rate,
            |column| column.get_mut(from + row..)?.first_chunk_mut(),
        );
    }
}

/// One block of rows, four columns a turn.
#[inline(always)]
fn descend_block<const B: usize, const R: usize, const C: usize>(
    columns: &mut [[f32; R]; C],
    bias: &mut [f32; B],
    source: &[f32; C],
    delta: &[f32; B],
    rate: f32,
    rows: impl Fn(&mut [f32; R]) -> Option<&mut [f32; B]>,
) {
    let delta = *delta;
    for (bias, delta) in bias.iter_mut().zip(&delta) {
        *bias -= rate * delta;
    }
    let (fours, last) = columns.as_chunks_mut::<4>();
    let (source_fours, source_last) = source.as_chunks::<4>();
    for ([a, b, c, d], [x_a, x_b, x_c, x_d]) in fours.iter_mut().zip(source_fours) {
        descend_column(rows(a), &delta, rate, x_a, R * C);
        descend_column(rows(b), &delta, rate, x_b, R * C);
        descend_column(rows(c), &delta, rate, x_c, R * C);
        descend_column(rows(d), &delta, rate, x_d, R * C);
    }
    for (column, source) in last.iter_mut().zip(source_last) {
        descend_column(rows(column), &delta, rate, source, R * C);
    }
}

/// One column of a block of rows, in a matrix of `entries`.
#[inline(always)]
fn descend_column<const B: usize>(
    weights: Option<&mut [f32; B]>,
    delta: &[f32; B],
    rate: f32,
    source: &f32,
    entries: usize,
) {
    let Some(weights) = weights else {
        return;
    };
    let mut moved = *weights;
    loaded(entries);
    let scale = rate * source;
    for (weight, delta) in moved.iter_mut().zip(delta) {
        *weight -= scale * delta;
    }
    *weights = moved;
    loaded(entries);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::network::{Relu, Sigmoid};

    const I: usize = 4;
    const H: usize = 9;
    const O: usize = 3;
    type Net<A> = BpNetwork<I, H, O, A>;

    fn step(learning_rate: f32, error_clip: f32) -> StepParameters {
        StepParameters {
            learning_rate,
            error_clip,
        }
    }

    /// The network's weights as one list, layer by layer.
    fn flatten<A: Activation>(net: &Net<A>) -> Vec<f64> {
        let weights = net.layers().concat();
        weights.into_iter().map(f64::from).collect()
    }

    fn change<A: Activation>(moved: &Net<A>, net: &Net<A>) -> Vec<f64> {
        let both = flatten(moved).into_iter().zip(flatten(net));
        both.map(|(moved, net)| moved - net).collect()
    }

    /// Twin in f64: the squared error written with plain indices, from the textbook.
    fn loss(weights: &[f64], x: &[f64], target: &[f64], activation: fn(f64) -> f64) -> f64 {
        let (w1, rest) = weights.split_at(H * I);
        let (b1, rest) = rest.split_at(H);
        let (w2, b2) = rest.split_at(O * H);
        let mut loss = 0.0;
        for o in 0..O {
            let mut y = b2[o];
            for h in 0..H {
                let u: f64 = (0..I).map(|i| w1[i * H + h] * x[i]).sum();
                y += w2[h * O + o] * activation(u + b1[h]);
            }
            loss += 0.5 * (y - target[o]).powi(2);
        }
        loss
    }

    /// Largest deviation of a step from the gradient by central differences, as a part of the step.
    fn worst_step_error<A: Activation>(activation: fn(f64) -> f64) -> f64 {
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        let mut worst = 0.0f64;
        for seed in 0..20 {
            let net: Net<A> = BpNetwork::random(seed);
            let x: [f32; I] =
                core::array::from_fn(|i| ((seed as f32 + 1.3) * (i as f32 + 0.7)).sin());
            let target: [f32; O] = core::array::from_fn(|o| (seed as f32 * 0.9 + o as f32).cos());
            let mut moved = net;
            moved.update(&x.into(), &target.into(), &step(0.5, 10.0));
            let change = change(&moved, &net);
            let (x, target) = (x.map(f64::from), target.map(f64::from));
            let difference = |k: usize| {
                let [above, below] = [1e-6, -1e-6].map(|step| {
                    let mut weights = flatten(&net);
                    weights[k] += step;
                    loss(&weights, &x, &target, activation)
                });
                (above - below) / 2e-6
            };
            let gradient: Vec<f64> = (0..change.len()).map(difference).collect();
            let rate = -dot(&change, &gradient) / dot(&gradient, &gradient);
            assert!(rate > 0.0, "seed {seed}: {rate}");
            let size = dot(&change, &change).sqrt();
            for (change, gradient) in change.iter().zip(&gradient) {
                worst = worst.max((change + rate * gradient).abs() / size);
            }
        }
        worst
    }

    #[test]
    fn a_step_goes_down_the_gradient_by_central_differences_in_f64() {
        // f32 carries 6e-8 relative through some 40 sums of order one.
        assert!(worst_step_error::<Relu>(|x| x.max(0.0)) < 2e-5);
        assert!(worst_step_error::<Sigmoid>(|x| 1.0 / (1.0 + (-x).exp())) < 2e-5);
    }

    #[test]
    fn an_outlier_moves_the_weights_by_no_more_than_the_clip_allows() {
        let parameters = step(0.5, 0.02);
        for scale in [1e-3, 1.0, 1e3, 1e9] {
            let net: Net<Relu> = BpNetwork::random(2);
            let mut moved = net;
            moved.update(
                &SVector::from([scale, -scale, scale, 1.0]),
                &SVector::from([1e12, -1e12, 0.0]),
                &parameters,
            );
            let change: f64 = change(&moved, &net).iter().map(|c| c * c).sum();
            let (change, bound) = (change.sqrt(), 0.5 * 0.5 * 0.02 * 3f64.sqrt());
            assert!(change <= bound * 1.001, "{change} at {scale}");
        }
    }

    #[test]
    fn what_is_not_finite_changes_no_weight() {
        let infinite = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, f32::MAX];
        let inputs = infinite.map(|bad| (bad, 0.0));
        for (input, target) in inputs.into_iter().chain([(0.0, f32::NAN)]) {
            let net: Net<Relu> = BpNetwork::random(2);
            let mut moved = net;
            let x = SVector::from([input, 0.0, 0.0, 0.0]);
            moved.update(&x, &SVector::from([target, 0.0, 0.0]), &step(0.1, 1.0));
            assert_eq!(moved, net, "input {input}, target {target}");
        }
    }

    #[test]
    fn a_small_network_learns_more_than_half_of_a_stribeck_curve() {
        let mut net: BpNetwork<3, 6, 1> = BpNetwork::silent(11);
        let inputs = |v: f32| SVector::from([0.5 * v, (v / 0.03).tanh(), (v / 0.15).tanh()]);
        let curve = |v: f32| 0.02 * (v / 0.03).tanh() * (-(v / 0.1) * (v / 0.1)).exp();
        let parameters = step(0.05, 0.05);
        let rms = |net: &BpNetwork<3, 6, 1>| {
            let error = |k: i32| net.forward(&inputs(k as f32 * 0.01))[0] - curve(k as f32 * 0.01);
            ((-100..=100).map(|k| error(k).powi(2)).sum::<f32>() / 201.0).sqrt()
        };
        let before = rms(&net);
        for tick in 0..60_000 {
            // Multiples of the golden ratio visit ±1 evenly in a mixed order.
            let v = 2.0 * (f64::from(tick) * 0.618_033_988_75).fract() as f32 - 1.0;
            net.update(&inputs(v), &SVector::from([curve(v)]), &parameters);
        }
        assert!(rms(&net) < 0.5 * before, "{} of {before}", rms(&net));
    }
}
