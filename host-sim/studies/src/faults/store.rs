//! Faults of the flash under the store: power cuts, wear, protection, bit rot, foreign sets.

use super::Campaign;
use crate::StudyError;
use foretorque::arm::Arm;
use foretorque::arm::ur5::{JOINTS, PARAMETERS, Ur5};
use foretorque_flash::{Protection, SimulatedFlash, Torn};
use foretorque_link::bank::ParameterBank;
use foretorque_link::store::{HEADER_BYTES, SLOT_BYTES, Store, StoreError, slots};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Bytes of a sector of the STM32F405's flash that the store uses (RM0090 table 5: sectors 10 and 11).
pub const SECTOR: usize = 128 * 1024;
/// Two slots a sector: every way of filling and erasing is a few saves away.
pub const SMALL_SECTOR: usize = 2 * SLOT_BYTES as usize;

type Flash<const S: usize> = SimulatedFlash<S>;

/// The bytes of set `number`: the nominal bank of the UR5 with one mass of its own.
pub fn set(number: u32) -> Vec<u8> {
    let mut bank = ParameterBank::nominal::<Ur5, JOINTS, PARAMETERS>();
    if let Some(column) = bank.columns.first_mut() {
        column.value = number as f32;
    }
    let mut buffer = [0; ParameterBank::MAX_BYTES];
    bank.encode(&mut buffer).map_or(Vec::new(), <[u8]>::to_vec)
}

/// The newest set that the store loads.
fn load<const S: usize>(store: &mut Store<Flash<S>>) -> Result<Vec<u8>, StoreError> {
    let mut buffer = [0; ParameterBank::MAX_BYTES];
    store.load(Ur5::HASH, &mut buffer).map(<[u8]>::to_vec)
}

/// Saves set `number`; true if it is loaded afterwards.
fn keeps<const S: usize>(store: &mut Store<Flash<S>>, number: u32) -> bool {
    let newest = set(number);
    store.save(Ur5::HASH, &newest).is_ok() && load(store) == Ok(newest)
}

/// A store in new flash after sets 1 to `saves`.
fn with_history<const S: usize>(saves: u32, seed: u64) -> Result<Store<Flash<S>>, StoreError> {
    let mut store = Store::new(Flash::new(seed));
    for number in 1..=saves {
        store.save(Ur5::HASH, &set(number))?;
    }
    Ok(store)
}

/// Cuts the power in every step of a save in every way, after each number of saves in `histories`.
///
/// A set is lost when neither the one before nor the one under way is loaded. The board is back when it can save again.
pub(super) fn power_cuts<const S: usize>(
    histories: impl IntoIterator<Item = u32>,
    seed: u64,
) -> Result<Campaign, StudyError> {
    let mut campaign = Campaign::new("power cut in a save", "simulated flash");
    for saves in histories {
        let base: Store<Flash<S>> = with_history(saves, seed)?;
        let (old, new) = (set(saves), set(saves + 1));
        let mut whole = Store::new(base.flash().clone());
        whole.save(Ur5::HASH, &new)?;
        let steps = whole.flash().steps() - base.flash().steps();
        for step in 0..steps {
            for torn in Torn::SECTOR {
                let mut store = Store::new(base.flash().clone());
                store.flash_mut().cut_after(step, torn);
                let reported = store.save(Ur5::HASH, &new).is_ok();
                store.flash_mut().power_on();
                let kept = match load(&mut store) {
                    Ok(found) => found == new || (saves > 0 && found == old),
                    Err(StoreError::Empty | StoreError::Damaged) => saves == 0,
                    Err(_) => false,
                };
                campaign.case(kept && !reported, keeps(&mut store, saves + 2));
            }
        }
    }
    Ok(campaign)
}

/// A life of `saves` saves, in every second of which the power goes at a random step in a random way, and often again in
/// the save that follows.
pub(super) fn power_cut_life(saves: u32, seed: u64) -> Campaign {
    let mut campaign = Campaign::new("power cuts through a long life", "simulated flash");
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut store = Store::new(Flash::<SMALL_SECTOR>::new(seed));
    // What may be loaded: the newest set that was acknowledged, and those that were under way since.
    let (mut ever, mut loadable) = (false, Vec::new());
    for number in 1..=saves {
        let new = set(number);
        if random.random() {
            let steps = (new.len() + HEADER_BYTES).div_ceil(4) as u64 + 1;
            let torn = Torn::SECTOR[random.random_range(0..Torn::SECTOR.len())];
            let step = random.random_range(0..steps);
            store.flash_mut().cut_after(step, torn);
        }
        let acknowledged = store.save(Ur5::HASH, &new).is_ok();
        store.flash_mut().power_on();
        if acknowledged {
            (ever, loadable) = (true, Vec::new());
        } else {
            campaign.injected += 1;
        }
        loadable.push(new);
        let kept = match load(&mut store) {
            Ok(found) => loadable.contains(&found),
            Err(_) => !ever,
        };
        campaign.lost_sets += u64::from(!kept);
        campaign.recovered += u64::from(!acknowledged && kept);
    }
    campaign
}

/// Saves on flash that wears out bit by bit, four more before each save, until `saves` are tried.
///
/// A save that the store acknowledges must be there, one that it refuses must have left the one before.
pub(super) fn worn(saves: u32, seed: u64) -> Campaign {
    const BITS: usize = 4;
    let mut campaign = Campaign::new("worn flash", "simulated flash");
    let mut store = Store::new(Flash::<SMALL_SECTOR>::new(seed));
    let mut last = None;
    for number in 1..=saves {
        store.flash_mut().wear(0..2 * SMALL_SECTOR, BITS);
        let new = set(number);
        if store.save(Ur5::HASH, &new).is_ok() {
            last = Some(new);
        }
        campaign.injected += BITS as u64;
        let kept = load(&mut store).ok() == last;
        campaign.lost_sets += u64::from(!kept);
        campaign.recovered += if kept { BITS as u64 } else { 0 };
    }
    campaign
}

/// Saves into flash that refuses, one refusal in each way after up to six saves.
pub(super) fn protected(seed: u64) -> Result<Campaign, StudyError> {
    let mut campaign = Campaign::new("write-protected flash", "simulated flash");
    for saves in 0..=6 {
        for protection in [Protection::Silent, Protection::Reported] {
            let mut store: Store<Flash<SMALL_SECTOR>> = with_history(saves, seed)?;
            store.flash_mut().protect(protection);
            let refused = store.save(Ur5::HASH, &set(saves + 1)).is_err();
            let found = load(&mut store);
            let kept = refused
                && match saves {
                    0 => found.is_err(),
                    _ => found == Ok(set(saves)),
                };
            store.flash_mut().protect(Protection::None);
            campaign.case(kept, keeps(&mut store, saves + 1));
        }
    }
    Ok(campaign)
}

/// Turns each bit of the second of two records in turn: never may it be loaded, and the set before it must be.
pub(super) fn bit_rot(seed: u64) -> Result<Campaign, StudyError> {
    let mut campaign = Campaign::new("bit rot in the newest set", "simulated flash");
    let mut store: Store<Flash<SMALL_SECTOR>> = with_history(2, seed)?;
    let start = SLOT_BYTES as usize;
    for place in start..start + HEADER_BYTES + set(2).len() {
        for bit in 0..8 {
            store.flash_mut().rot(place, bit);
            let before = load(&mut store) == Ok(set(1));
            store.flash_mut().rot(place, bit);
            campaign.case(before, load(&mut store) == Ok(set(2)));
        }
    }
    Ok(campaign)
}

/// Sets of another robot, before and after own ones: none is loaded, none keeps the own one from being found.
pub(super) fn foreign_sets(seed: u64) -> Result<Campaign, StudyError> {
    let mut campaign = Campaign::new("stored sets of another robot", "simulated flash");
    let sector = slots(SMALL_SECTOR as u32);
    for own in 0..2 * sector + 2 {
        for foreign in 1..2 * sector + 2 {
            let mut store: Store<Flash<SMALL_SECTOR>> = with_history(own, seed)?;
            // As much of the other robot's sets as one stay of the chip in another board leaves beside the own ones.
            for number in 0..foreign.min(sector) {
                store.save(!Ur5::HASH, &set(1000 + number))?;
            }
            let kept = match load(&mut store) {
                Ok(found) => own > 0 && found == set(own),
                Err(StoreError::WrongArm { found }) => found == !Ur5::HASH && own == 0,
                Err(_) => false,
            };
            campaign.case(kept, keeps(&mut store, own + 1));
        }
    }
    Ok(campaign)
}
