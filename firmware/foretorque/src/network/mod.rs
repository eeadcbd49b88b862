//! The back-propagation (BP) network and its gradient. Independent of robots.

mod gradient;

pub use gradient::StepParameters;

use crate::math::tanh;
use core::hint::black_box;
use core::marker::PhantomData;
use nalgebra::{ArrayStorage, SMatrix, SVector};

/// Activation function of a hidden unit.
///
/// The slope is computed from the unit's *output*, which back-propagation has at hand, never from its input: all three
/// activations below allow it, and it saves the second evaluation.
pub trait Activation: Copy + core::fmt::Debug + PartialEq + 'static {
    /// Output of a unit whose weighted input is `x`.
    fn value(x: f32) -> f32;
    /// Derivative of the output with respect to the weighted input, where the output is `y`.
    fn slope(y: f32) -> f32;
}

/// `max(0, x)`.  [paper eq. 19]
///
/// The slope at the kink is taken as zero. A not-a-number stays one: a fault must not hide behind a comparison.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Relu;

impl Activation for Relu {
    fn value(x: f32) -> f32 {
        if x < 0.0 { 0.0 } else { x }
    }

    fn slope(y: f32) -> f32 {
        if y > 0.0 { 1.0 } else { 0.0 }
    }
}

/// `1 / (1 + exp(-x))`, computed as `(1 + tanh(x / 2)) / 2`, which cannot overflow.  [paper eq. 18]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sigmoid;

impl Activation for Sigmoid {
    fn value(x: f32) -> f32 {
        0.5 + 0.5 * tanh(0.5 * x)
    }

    fn slope(y: f32) -> f32 {
        y * (1.0 - y)
    }
}

/// A back-propagation network with one hidden layer: `I` inputs, `H` hidden units, `O` linear outputs.
///
/// ```text
/// a = activation(W1 x + b1)        y = W2 a + b2
/// ```
///
/// Dense at any width (18-32-6 is the paper's form). A block-masked network, in which an output sees only its own
/// inputs and hidden units, is an array of small networks: the same weights without the zeros.
///
/// Weights are stored column by column (all weights that leave one unit lie together), so both passes sweep memory
/// forwards and add into accumulators.
///
/// ```
/// use foretorque::network::{BpNetwork, Sigmoid};
/// use nalgebra::SVector;
/// let network: BpNetwork<3, 6, 2, Sigmoid> = BpNetwork::random(1);
/// let y = network.forward(&SVector::from([0.1, -0.2, 0.3]));
/// assert!(y.iter().all(|y| y.is_finite()));
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BpNetwork<const I: usize, const H: usize, const O: usize, A: Activation = Relu> {
    /// Weights of the hidden layer `W1`, one row a unit.
    pub hidden_weights: SMatrix<f32, H, I>,
    /// Thresholds of the hidden layer `b1`.
    pub hidden_bias: SVector<f32, H>,
    /// Weights of the output layer `W2`, one row an output.
    pub output_weights: SMatrix<f32, O, H>,
    /// Thresholds of the output layer `b2`.
    pub output_bias: SVector<f32, O>,
    /// The activation is part of what the weights mean, so it is part of the type.
    pub activation: PhantomData<A>,
}

impl<const I: usize, const H: usize, const O: usize, A: Activation> BpNetwork<I, H, O, A> {
    /// Number of weights and thresholds.
    pub const WEIGHTS: usize = H * I + H + O * H + O;

    /// The network whose weights are all zero; its output is zero.
    pub const fn zeros() -> Self {
        Self {
            hidden_weights: SMatrix::from_array_storage(ArrayStorage([[0.0; H]; I])),
            hidden_bias: SVector::from_array_storage(ArrayStorage([[0.0; H]; 1])),
            output_weights: SMatrix::from_array_storage(ArrayStorage([[0.0; O]; H])),
            output_bias: SVector::from_array_storage(ArrayStorage([[0.0; O]; 1])),
            activation: PhantomData,
        }
    }

    /// A random start: weights uniform in `±sqrt(6 / fan_in)` for the hidden layer [He 2015] and in
    /// `±sqrt(6 / (H + O))` for the output layer [Glorot 2010], thresholds zero. The same seed gives the same bits.
    pub fn random(seed: u32) -> Self {
        let mut start = RandomStart::new(seed);
        let mut network = Self::silent_from(&mut start);
        let reach = libm::sqrtf(6.0 / (H + O) as f32);
        for weight in network.output_weights.iter_mut() {
            *weight = reach * start.symmetric();
        }
        network
    }

    /// A random hidden layer under an output layer of zeros: the output is zero until something is learnt.
    ///
    /// The second half of the units mirrors the first. With `relu(u) − relu(−u) = u` and `relu(u) + relu(−u) = |u|` the
    /// output layer alone can then form any odd and any even function of the units' inputs, whatever the seed.
    pub fn silent(seed: u32) -> Self {
        let mut network = Self::silent_from(&mut RandomStart::new(seed));
        for weights in &mut network.hidden_weights.data.0 {
            let (first, second) = weights.split_at_mut(H / 2);
            for (mirrored, weight) in second.iter_mut().zip(first) {
                *mirrored = -*weight;
            }
        }
        network
    }

    /// This hidden layer under an output layer of zeros.
    pub fn silenced(mut self) -> Self {
        self.output_weights = SMatrix::zeros();
        self.output_bias = SVector::zeros();
        self
    }

    fn silent_from(start: &mut RandomStart) -> Self {
        let mut network = Self::zeros();
        let reach = libm::sqrtf(6.0 / I as f32);
        for weight in network.hidden_weights.as_mut_slice() {
            *weight = reach * start.symmetric();
        }
        network
    }

    /// Weights and thresholds layer by layer, in the order of a bank: hidden weights and thresholds, those of the output.
    pub fn layers(&self) -> [&[f32]; 4] {
        [
            self.hidden_weights.as_slice(),
            self.hidden_bias.as_slice(),
            self.output_weights.as_slice(),
            self.output_bias.as_slice(),
        ]
    }

    /// [`layers`](Self::layers), to be written.
    pub fn layers_mut(&mut self) -> [&mut [f32]; 4] {
        [
            self.hidden_weights.as_mut_slice(),
            self.hidden_bias.as_mut_slice(),
            self.output_weights.as_mut_slice(),
            self.output_bias.as_mut_slice(),
        ]
    }

    /// Output of the network for input `x`.
    ///
    /// Cost: `I H + H O` multiply-adds and `H` activations.
    #[inline(always)]
    pub fn forward(&self, x: &SVector<f32, I>) -> SVector<f32, O> {
        self.output(&self.hidden(x))
    }

    /// Outputs of the hidden units for input `x`.
    #[inline(always)]
    pub fn hidden(&self, x: &SVector<f32, I>) -> SVector<f32, H> {
        let mut a = unset();
        self.hidden_into(x, &mut a);
        a
    }

    /// [`hidden`](Self::hidden), written where it shall be.
    #[inline(always)]
    fn hidden_into(&self, x: &SVector<f32, I>, a: &mut SVector<f32, H>) {
        layer(&self.hidden_weights, &self.hidden_bias, x, A::value, a);
    }

    /// Output of the network for hidden outputs `a`.
    #[inline(always)]
    pub fn output(&self, a: &SVector<f32, H>) -> SVector<f32, O> {
        let mut y = unset();
        layer(&self.output_weights, &self.output_bias, a, |y| y, &mut y);
        y
    }

    /// Every weight and threshold is a finite number.
    pub fn is_finite(&self) -> bool {
        // One sum instead of a test per weight: 0 × finite is 0, 0 × anything else is not a number.
        let hidden: f32 = self.hidden_weights.iter().map(|w| w * 0.0).sum();
        let output: f32 = self.output_weights.iter().map(|w| w * 0.0).sum();
        let bias: f32 = self.hidden_bias.iter().map(|w| w * 0.0).sum();
        let offset: f32 = self.output_bias.iter().map(|w| w * 0.0).sum();
        hidden + output + bias + offset == 0.0
    }
}

/// `y = activation(W x + b)`, in blocks of eight, six, four, two and one rows whose sums stay in registers while the columns go
/// by.
///
/// Every element adds its products in the order of the columns whatever its block, so the bits do not depend on it.
#[inline(always)]
fn layer<const R: usize, const C: usize>(
    weights: &SMatrix<f32, R, C>,
    bias: &SVector<f32, R>,
    x: &SVector<f32, C>,
    activation: impl Fn(f32) -> f32 + Copy,
    y: &mut SVector<f32, R>,
) {
    let columns = opaque(&weights.data.0, R * C);
    let x: &[f32; C] = opaque(&x.data.0[0], R * C);
    let (eights, rest) = y.as_mut_slice().as_chunks_mut::<8>();
    let (bias_eights, bias_rest) = bias.as_slice().as_chunks::<8>();
    for (index, (y, bias)) in eights.iter_mut().zip(bias_eights).enumerate() {
        let sums = block(columns, bias, x, |column| {
            column.as_chunks::<8>().0.get(index)
        });
        *y = sums.map(activation);
    }
    let (sixes, rest) = rest.as_chunks_mut::<6>();
    let (bias_sixes, bias_rest) = bias_rest.as_chunks::<6>();
    for (y, bias) in sixes.iter_mut().zip(bias_sixes) {
        let sums = block(columns, bias, x, |column| tail::<8>(column).first_chunk());
        *y = sums.map(activation);
    }
    let from = R - rest.len();
    for (row, (y, bias)) in rest.iter_mut().zip(bias_rest).enumerate() {
        let [sum] = block(columns, &[*bias], x, |column| {
            column.get(from + row..)?.first_chunk()
        });
        *y = activation(sum);
    }
}

/// Memory that is written before it is read: −0, not 0, which would be a call of memset.
#[inline(always)]
fn unset<const R: usize>() -> SVector<f32, R> {
    SVector::from([-0.0; R])
}

/// Rest of `column` after whole blocks of `BLOCK` rows.
#[inline(always)]
fn tail<const BLOCK: usize>(column: &[f32]) -> &[f32] {
    column.as_chunks::<BLOCK>().1
}

/// `b + W x` of one block of rows, two columns at a time.
#[inline(always)]
fn block<const B: usize, const R: usize, const C: usize>(
    columns: &[[f32; R]; C],
    bias: &[f32; B],
    x: &[f32; C],
    rows: impl Fn(&[f32; R]) -> Option<&[f32; B]>,
) -> [f32; B] {
    let mut sums = *bias;
    let (pairs, last) = columns.as_chunks::<2>();
    let (x_pairs, x_last) = x.as_chunks::<2>();
    for ([one, two], x) in pairs.iter().zip(x_pairs) {
        if let (Some(&one), Some(&two)) = (rows(one), rows(two)) {
            loaded(R * C);
            let [x_one, x_two] = *x;
            for (sum, weight) in sums.iter_mut().zip(one) {
                *sum += weight * x_one;
            }
            for (sum, weight) in sums.iter_mut().zip(two) {
                *sum += weight * x_two;
            }
        }
    }
    for (column, x) in last.iter().zip(x_last) {
        if let Some(rows) = rows(column) {
            for (sum, weight) in sums.iter_mut().zip(rows) {
                *sum += weight * x;
            }
        }
    }
    sums
}

/// A matrix of `entries` is large enough for its loops to be arranged; a small one is best left to the compiler.
const fn arranged(entries: usize) -> bool {
    entries >= 64
}

/// Opaque copy of a reference; into a large matrix of `entries` the compiler can deduce nothing about it, so that a value
/// read through it stays on its side of [`loaded`].
#[inline(always)]
fn opaque<T>(reference: T, entries: usize) -> T {
    if arranged(entries) {
        black_box(reference)
    } else {
        reference
    }
}

/// In the loops over a large matrix of `entries`, what was read from memory before is read before: loads one after the
/// other take a Cortex-M4 one cycle each, loads between multiplications two. It costs nothing, and the loop around it
/// stays as it is written.
#[inline(always)]
fn loaded(entries: usize) {
    if arranged(entries) {
        black_box(());
    }
}

/// Seeded source of starting weights: xorshift, period 2³² − 1.  [Marsaglia 2003, shifts 13, 17, 5]
struct RandomStart {
    state: u32,
}

impl RandomStart {
    /// Neighbouring seeds are spread by a multiplication first; the state must not be zero.
    fn new(seed: u32) -> Self {
        let state = seed.wrapping_mul(0x9E37_79B1) ^ 0x85EB_CA6B;
        Self {
            state: if state == 0 { 1 } else { state },
        }
    }

    /// The next number, uniform in ±1.
    fn symmetric(&mut self) -> f32 {
        self.state ^= self.state << 13;
        self.state ^= self.state >> 17;
        self.state ^= self.state << 5;
        // 24 bits are what an f32 holds exactly.
        (self.state >> 8) as f32 * (2.0 / 16_777_216.0) - 1.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn slope_error<A: Activation>(x: f64, exact: fn(f64) -> f64) -> f64 {
        let step = 1e-5;
        let difference = (exact(x + step) - exact(x - step)) / (2.0 * step);
        (f64::from(A::slope(A::value(x as f32))) - difference).abs()
    }

    #[test]
    fn slopes_are_the_derivatives_of_the_textbook_functions() {
        for k in -40..=40 {
            let x = f64::from(k) * 0.15 + 0.01;
            assert!(slope_error::<Relu>(x, |x| x.max(0.0)) < 1e-6, "relu at {x}");
            let sigmoid = slope_error::<Sigmoid>(x, |x| 1.0 / (1.0 + (-x).exp()));
            assert!(sigmoid < 1e-6, "sigmoid at {x}");
        }
    }

    #[test]
    fn the_blocked_sweep_is_the_matrix_product_at_any_width() {
        fn error<const H: usize, const O: usize>() -> f32 {
            let network: BpNetwork<18, H, O, Sigmoid> = BpNetwork::random(7);
            let x = SVector::<f32, 18>::from_fn(|i, _| (i as f32 * 0.7).sin());
            let a = (network.hidden_weights * x + network.hidden_bias).map(Sigmoid::value);
            let y = network.output_weights * a + network.output_bias;
            (network.forward(&x) - y).amax()
        }
        let errors = [
            error::<32, 6>(),
            error::<35, 1>(),
            error::<13, 7>(),
            error::<6, 5>(),
        ];
        assert!(errors.iter().all(|&e| e < 1e-5), "{errors:?}");
    }

    #[test]
    fn the_same_seed_gives_the_same_weights_and_another_seed_others() {
        type Net = BpNetwork<3, 6, 1>;
        assert_eq!(Net::random(5), Net::random(5));
        assert_ne!(Net::random(5), Net::random(6));
    }

    #[test]
    fn random_weights_fill_their_range() {
        let network: BpNetwork<18, 32, 6, Sigmoid> = BpNetwork::random(3);
        let reach = (6.0f32 / 18.0).sqrt();
        let largest = network.hidden_weights.amax();
        assert!(largest <= reach && largest > 0.95 * reach, "{largest}");
        let mean = network.hidden_weights.sum() / 576.0;
        assert!(mean.abs() < 0.05, "{mean}");
    }

    #[test]
    fn a_silent_network_says_nothing() {
        let network: BpNetwork<3, 6, 1> = BpNetwork::silent(9);
        assert_eq!(network.forward(&SVector::from([1.0, -2.0, 3.0]))[0], 0.0);
    }

    #[test]
    fn one_bad_weight_is_noticed_in_every_layer() {
        type Net = BpNetwork<3, 6, 1>;
        let corrupt: [fn(&mut Net); 4] = [
            |n| n.hidden_weights[(5, 2)] = f32::NAN,
            |n| n.hidden_bias[5] = f32::INFINITY,
            |n| n.output_weights[(0, 5)] = f32::NEG_INFINITY,
            |n| n.output_bias[0] = f32::NAN,
        ];
        assert!(Net::random(1).is_finite());
        for corrupt in corrupt {
            let mut network = Net::random(1);
            corrupt(&mut network);
            assert!(!network.is_finite());
        }
    }

    #[test]
    fn numbers_are_uniform_and_never_stick() {
        let mut start = RandomStart::new(0);
        let mut counts = [0; 10];
        for _ in 0..10_000 {
            let x = start.symmetric();
            assert!((-1.0..1.0).contains(&x));
            counts[((x + 1.0) * 5.0) as usize] += 1;
        }
        let even = counts.iter().all(|&c| (850..1150).contains(&c));
        assert!(even, "{counts:?}");
    }
}
