//! Time of a frame on its bus.

use foretorque_link::drives::Frame;
use serde::Deserialize;

/// Bit rates of a bus.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BitRates {
    /// Of classic frames and of the arbitration phase, bit/s.
    #[serde(rename = "bit_s")]
    pub nominal: f64,
    /// Of the data phase of CAN-FD, bit/s.
    #[serde(rename = "data_bit_s", default = "fast")]
    pub data: f64,
}

impl Default for BitRates {
    fn default() -> Self {
        Self {
            nominal: 1e6,
            data: fast(),
        }
    }
}

fn fast() -> f64 {
    5e6
}

/// Longest time of a frame on the bus, with worst-case bit stuffing and the gap behind it, s. Source: ISO 11898-1.
pub fn frame_time_s(frame: &Frame, rates: &BitRates) -> f64 {
    let bytes = frame.bytes().len() as f64;
    let stuffed = |bits: f64| bits + ((bits - 1.0) / 4.0).floor();
    // Start, identifier and control, up to the length code; delimiters, acknowledgement, end and gap are not stuffed.
    let head = if frame.extended { 39.0 } else { 19.0 };
    if frame.fd {
        // CRC of 17 or 21 bits with its own fixed stuff bits and the stuff count.
        let crc = if bytes <= 16.0 { 17.0 } else { 21.0 };
        let slow = stuffed(head - 2.0) + 13.0;
        let quick = stuffed(6.0 + 8.0 * bytes) + crc + (crc / 4.0).ceil() + 4.0;
        return slow / rates.nominal + quick / rates.data;
    }
    (stuffed(head + 8.0 * bytes + 15.0) + 13.0) / rates.nominal
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn classic_frames_of_eight_bytes_take_135_and_160_bits_at_most() {
        let rates = BitRates::default();
        let bits = |frame: Frame| (frame_time_s(&frame, &rates) * 1e6).round();
        assert_eq!(bits(Frame::standard(1, &[0; 8])), 135.0);
        assert_eq!(bits(Frame::extended(1, &[0; 8])), 160.0);
        let moteus = bits(Frame::extended(0x8001, &[0; 13]).into_fd(0x50));
        assert!((60.0..120.0).contains(&moteus), "{moteus}");
    }
}
