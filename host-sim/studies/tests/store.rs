//! The store on simulated flash: whatever happens to power and cells, the last good set is found.

use foretorque::arm::Arm;
use foretorque::arm::ur5::Ur5;
use foretorque_link::bank::ParameterBank;
use foretorque_link::store::{Store, StoreError, saves, slots};
use foretorque_studies::faults::store::{self, SECTOR, SMALL_SECTOR, set};
use foretorque_workbench::board::flash::SimulatedFlash;

const SEED: u64 = 1;

fn loaded<const S: usize>(store: &mut Store<SimulatedFlash<S>>) -> Result<Vec<u8>, StoreError> {
    let mut buffer = [0; ParameterBank::MAX_BYTES];
    store.load(Ur5::HASH, &mut buffer).map(<[u8]>::to_vec)
}

#[test]
fn a_power_cut_in_any_step_of_a_save_loses_no_set() {
    // New flash, and every way in which two sectors of two slots can be filled, erased and filled again.
    let campaign = store::power_cuts::<SMALL_SECTOR>(0..=6, SEED).unwrap();
    assert!(campaign.is_survived(), "{campaign:?}");
    assert!(campaign.injected > 10_000, "{campaign:?}");
}

#[test]
fn a_power_cut_while_the_real_sector_is_erased_loses_no_set() {
    let full = slots(SECTOR as u32);
    let campaign = store::power_cuts::<SECTOR>([full], SEED).unwrap();
    assert!(campaign.is_survived(), "{campaign:?}");
}

#[test]
fn a_life_of_power_cuts_loses_no_set() {
    let campaign = store::power_cut_life::<SMALL_SECTOR>(3000, SEED);
    assert!(campaign.is_survived(), "{campaign:?}");
    assert!(campaign.injected > 1000, "{campaign:?}");
}

#[test]
fn worn_cells_cost_saves_but_never_the_set_before() {
    let campaign = store::worn::<SMALL_SECTOR>(300, 4, SEED);
    assert!(campaign.is_survived(), "{campaign:?}");
}

#[test]
fn a_flash_that_keeps_nothing_is_noticed_and_keeps_what_it_has() {
    let campaign = store::protected::<SMALL_SECTOR>(0..=6, SEED).unwrap();
    assert!(campaign.is_survived(), "{campaign:?}");
}

#[test]
fn one_bad_bit_brings_back_the_set_before() {
    let campaign = store::bit_rot::<SMALL_SECTOR>(2, SEED).unwrap();
    assert!(campaign.is_survived(), "{campaign:?}");
}

#[test]
fn another_robots_sets_are_refused_and_cost_nothing() {
    let campaign = store::foreign_sets::<SMALL_SECTOR>(SEED).unwrap();
    assert!(campaign.is_survived(), "{campaign:?}");
}

#[test]
fn absence_is_told_apart() {
    let mut store = Store::new(SimulatedFlash::<SMALL_SECTOR>::new(SEED));
    assert_eq!(loaded(&mut store), Err(StoreError::Empty));
    store.save(7, &set(1)).unwrap();
    assert_eq!(loaded(&mut store), Err(StoreError::WrongArm { found: 7 }));
    store.flash_mut().rot(40, 3);
    assert_eq!(loaded(&mut store), Err(StoreError::Damaged));
    let long = vec![0; 5000];
    assert_eq!(store.save(7, &long), Err(StoreError::TooLong));
}

#[test]
fn saves_wear_both_sectors_alike_and_rewrite_no_word() {
    let mut store = Store::new(SimulatedFlash::<SECTOR>::new(SEED));
    let rounds = 5;
    let each = 2 * slots(SECTOR as u32);
    for number in 1..=rounds * each {
        store.save(Ur5::HASH, &set(number)).unwrap();
    }
    assert_eq!(loaded(&mut store), Ok(set(rounds * each)));
    assert_eq!(store.flash().rewritten(), 0);
    assert_eq!(store.flash().erases(), [u64::from(rounds); 2]);
    // The budget that the documentation states, from what was counted.
    assert_eq!(saves(SECTOR as u32), each * 10_000);
}
