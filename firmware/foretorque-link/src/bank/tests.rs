use super::*;
use foretorque::arm::Arm;
use foretorque::arm::ur5::Ur5;
use foretorque::dynamics::{FRICTION_COLUMNS, FrictionColumn, FrictionParameters};
use foretorque::feedforward::FeedForwardConfig;
use foretorque::learning::ParameterSet;
use proptest::prelude::*;
use std::format;
use std::string::{String, ToString};
use std::vec::Vec as List;

const N: usize = 6;
const P: usize = 40;

fn nominal() -> ParameterBank {
    ParameterBank::nominal::<Ur5, N, P>()
}

fn bytes(bank: &ParameterBank) -> List<u8> {
    let mut room = [0; ParameterBank::MAX_BYTES];
    bank.encode(&mut room).unwrap().to_vec()
}

fn verdict(change: impl FnOnce(&mut ParameterBank)) -> Option<BankError> {
    let mut bank = nominal();
    change(&mut bank);
    let set = bank.set::<Ur5, N, P>().err();
    let gains = bank.drive_gains::<N>().err();
    set.or(gains)
        .or(bank.feed_forward_config::<Ur5, N, P>(1e-3).err())
}

#[test]
fn columns_are_named_link_by_link_then_rotors_then_friction() {
    let names: List<_> = nominal().columns.iter().map(|c| c.id.to_string()).collect();
    assert_eq!(names.len(), P + FRICTION_COLUMNS * N);
    let front = [
        "Izz1", "mx2", "my2", "Ixx2", "Izz2", "Ixy2", "Ixz2", "Iyz2", "mx3",
    ];
    assert_eq!(names[..9], front);
    assert_eq!(names[36..40], ["Ia3", "Ia4", "Ia5", "Ia6"]);
    let friction = (1..=N).flat_map(|joint| {
        FrictionColumn::ALL.map(|column| format!("{}{joint}", column.properties().symbol))
    });
    assert!(friction.eq(names[40..].iter().cloned()));
}

#[test]
fn kinds_of_columns_keep_their_numbers() {
    let symbols = (0..=u8::MAX).filter_map(|number| {
        let kind = ColumnKind::try_from(number).ok()?;
        Some((number, ColumnId { kind, joint: 0 }.to_string()))
    });
    let wanted = [
        "m1", "mx1", "my1", "mz1", "Ixx1", "Iyy1", "Izz1", "Ixy1", "Ixz1", "Iyz1", "Ia1", "Fv1",
        "Fc1", "Fsn1", "Fsw1", "Fo1", "Gs1", "Gc1", "Fs1", "Fb1", "Fl1",
    ];
    let wanted = (0..).zip(wanted.map(String::from));
    assert!(symbols.take(21).eq(wanted));
}

#[test]
fn the_nominal_bank_is_the_nominal_set_with_the_arms_limits() {
    let bank = nominal();
    let set = bank.set::<Ur5, N, P>().unwrap();
    assert_eq!(set, ParameterSet::nominal::<Ur5>(NETWORK_SEED));
    assert_eq!(set.rigid.as_slice(), Ur5::NOMINAL);
    assert!(bank.columns.iter().all(|column| column.deviation > 0.0));
    let config = bank.feed_forward_config::<Ur5, N, P>(1e-3).unwrap();
    let wanted = FeedForwardConfig::for_arm::<Ur5, P>(1e-3);
    assert_eq!(config.limits, wanted.limits);
    for (slew, wanted) in config.slew_per_tick.iter().zip(wanted.slew_per_tick) {
        // N·m/s times s against N·m a tick: one rounding apart.
        assert!((slew - wanted).abs() <= 2.0 * f32::EPSILON * wanted);
    }
}

#[test]
fn every_set_survives_the_bank_in_any_order_of_columns() {
    let mut set = ParameterSet::<N, P>::nominal::<Ur5>(3);
    for (k, value) in set.rigid.iter_mut().enumerate() {
        *value = k as f32 - 7.25;
    }
    for (j, friction) in set.friction.iter_mut().enumerate() {
        for (k, value) in friction.0.iter_mut().enumerate() {
            *value = 10.0 * k as f32 - 0.5 * j as f32;
        }
        set.network[j].output_bias[0] = 0.01 * j as f32;
        set.network[j].hidden_weights[(5, 1)] = j as f32;
    }
    let mut bank = ParameterBank::from_set::<Ur5, N, P>(&set);
    assert_eq!(bank.set::<Ur5, N, P>(), Ok(set));
    bank.columns.reverse();
    let again = ParameterBank::decode(&bytes(&bank)).unwrap();
    assert_eq!(again, bank);
    assert_eq!(again.set::<Ur5, N, P>(), Ok(set));
}

#[test]
fn a_bank_without_friction_columns_has_no_friction() {
    let mut bank = nominal();
    bank.columns.truncate(P);
    let set = bank.set::<Ur5, N, P>().unwrap();
    assert!(set.friction.iter().all(|&f| f == FrictionParameters::NONE));
}

#[test]
fn a_bank_from_before_load_offset_and_cogging_reads_them_as_zero() {
    let mut set = ParameterSet::<N, P>::nominal::<Ur5>(3);
    for friction in &mut set.friction {
        *friction = FrictionParameters([1.0; FRICTION_COLUMNS]);
    }
    let mut bank = ParameterBank::from_set::<Ur5, N, P>(&set);
    let new = [
        FrictionColumn::Load,
        FrictionColumn::Offset,
        FrictionColumn::CoggingSine,
        FrictionColumn::CoggingCosine,
    ];
    let kinds = new.map(ColumnKind::friction);
    bank.columns
        .retain(|column| !kinds.contains(&column.id.kind));
    let set = bank.set::<Ur5, N, P>().unwrap();
    for friction in set.friction {
        for column in FrictionColumn::ALL {
            let wanted = if new.contains(&column) { 0.0 } else { 1.0 };
            assert_eq!(friction[column], wanted, "{column:?}");
        }
    }
    // What is learnt in them since does not get lost.
    let mut learnt = set;
    learnt.friction[2][FrictionColumn::CoggingSine] = 0.4;
    bank.refresh::<Ur5, N, P>(&learnt);
    assert_eq!(bank.columns.len(), P + FRICTION_COLUMNS * N);
    assert_eq!(bank.set::<Ur5, N, P>(), Ok(learnt));
}

#[test]
fn a_bank_that_does_not_fit_the_arm_is_refused_with_the_place() {
    let foreign = BankError::WrongArm { found: !Ur5::HASH };
    assert_eq!(verdict(|_| {}), None);
    assert_eq!(verdict(|b| b.arm_hash = !b.arm_hash), Some(foreign));
    assert_eq!(
        verdict(|b| b.columns[3].value = f32::NAN),
        Some(BankError::Column(3))
    );
    assert_eq!(
        verdict(|b| b.columns[4].deviation = -1.0),
        Some(BankError::Column(4))
    );
    assert_eq!(
        verdict(|b| _ = b.columns.remove(5)),
        Some(BankError::MissingColumn(5))
    );
    assert_eq!(
        verdict(|b| b.columns[6].id.kind = ColumnKind::try_from(0).unwrap()),
        Some(BankError::UnknownColumn(6))
    );
    assert_eq!(
        verdict(|b| b.columns[7].id = b.columns[1].id),
        Some(BankError::UnknownColumn(7))
    );
    assert_eq!(
        verdict(|b| b.columns[41].id.joint = 6),
        Some(BankError::UnknownColumn(41))
    );
    assert_eq!(
        verdict(|b| b.network.hidden = 7),
        Some(BankError::NetworkShape)
    );
    assert_eq!(
        verdict(|b| b.network.activation = ActivationKind::Tanh),
        Some(BankError::NetworkShape)
    );
    assert_eq!(
        verdict(|b| _ = b.weights.pop()),
        Some(BankError::NetworkShape)
    );
    assert_eq!(
        verdict(|b| b.weights[100] = f32::INFINITY),
        Some(BankError::Weight(100))
    );
    assert_eq!(
        verdict(|b| b.drive_gains_nm_a[2] = -1.0),
        Some(BankError::DriveGain(2))
    );
    assert_eq!(
        verdict(|b| _ = b.drive_gains_nm_a.pop()),
        Some(BankError::DriveGain(5))
    );
    assert_eq!(
        verdict(|b| b.limits[1].torque_nm = 151.0),
        Some(BankError::Limit(1))
    );
    assert_eq!(
        verdict(|b| b.limits[0].slew_nm_s = 0.0),
        Some(BankError::Limit(0))
    );
    let widest = nominal().limits[3].slew_nm_s;
    assert_eq!(verdict(|b| b.limits[3].slew_nm_s = 0.5 * widest), None);
    for wider in [widest.next_up(), f32::INFINITY, f32::NAN] {
        assert_eq!(
            verdict(|b| b.limits[3].slew_nm_s = wider),
            Some(BankError::Limit(3))
        );
    }
    assert_eq!(verdict(|b| _ = b.limits.pop()), Some(BankError::Limit(5)));
}

#[test]
fn the_largest_bank_fits_the_room() {
    let mut bank = nominal();
    let column = bank.columns[0];
    while bank.columns.push(column).is_ok() {}
    while bank.weights.push(1.0).is_ok() {}
    while bank.drive_gains_nm_a.push(1.0).is_ok() {}
    let bounds = bank.limits[0];
    while bank.limits.push(bounds).is_ok() {}
    while bank.arm.push('x').is_ok() {}
    assert_eq!(bytes(&bank).len(), ParameterBank::MAX_BYTES);
    assert_eq!(bank.encode(&mut [0; 100]), Err(BankError::TooLong));
}

#[test]
fn another_format_version_and_other_bytes_are_told_apart() {
    let mut foreign = bytes(&nominal());
    foreign[4] = 2;
    assert_eq!(ParameterBank::decode(&foreign), Err(BankError::Version(2)));
    assert_eq!(ParameterBank::decode(b"hello"), Err(BankError::NotABank));
    assert_eq!(ParameterBank::decode(&[]), Err(BankError::NotABank));
    assert_eq!(ParameterBank::decode(b"FTPB"), Err(BankError::NotABank));
    let mut sealed = b"FTPB\x01nothing of the kind".to_vec();
    let crc = crate::wire::CRC.checksum(&sealed);
    sealed.extend(crc.to_le_bytes());
    assert_eq!(ParameterBank::decode(&sealed), Err(BankError::Malformed));
}

proptest! {
    #[test]
    fn up_to_three_flipped_bits_are_found(
        flips in prop::collection::vec((any::<prop::sample::Index>(), 0..8u32), 1..=3),
    ) {
        let good = bytes(&nominal());
        let mut damaged = good.clone();
        for (place, bit) in flips {
            damaged[place.index(good.len())] ^= 1 << bit;
        }
        prop_assert!(damaged == good || ParameterBank::decode(&damaged).is_err());
    }

    #[test]
    fn a_bank_cut_short_or_followed_by_more_is_refused(
        cut in any::<prop::sample::Index>(),
        more in prop::collection::vec(any::<u8>(), 1..50),
    ) {
        let good = bytes(&nominal());
        prop_assert!(ParameterBank::decode(&good[..cut.index(good.len())]).is_err());
        prop_assert!(ParameterBank::decode(&[good, more].concat()).is_err());
    }

    #[test]
    fn any_content_under_a_right_checksum_is_judged_without_panic(
        body in prop::collection::vec(any::<u8>(), 0..3000),
    ) {
        let mut sealed = b"FTPB\x01".to_vec();
        sealed.extend(body);
        let crc = crate::wire::CRC.checksum(&sealed);
        sealed.extend(crc.to_le_bytes());
        if let Ok(bank) = ParameterBank::decode(&sealed) {
            prop_assert!(bank.set::<Ur5, N, P>().is_err());
        }
    }
}
