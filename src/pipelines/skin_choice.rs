//! Which skin method weighs a mesh: the one that was asked for; unless one was, the best by measurement. Another takes its place
//! only where the caller named it for that.

use super::skin::SkinNets;
use super::{Models, RigError, SkinMethod};

/// Mean L1 to the artists' weights on validation rigs with their own skeletons, least is best.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MeasuredL1 {
    pub organic: f64,
    pub boxes: f64,
    /// All of them together.
    pub all: f64,
}

impl SkinMethod {
    /// What was measured of the shipped networks; the tables of `docs/models.md`, with which a test compares it.
    pub const fn measured(self) -> MeasuredL1 {
        let [organic, boxes, all] = match self {
            Self::HeterSkinNet => [0.455, 0.485, 0.467],
            Self::RigNet => [0.635, 0.842, 0.715],
            Self::GeodesicHeat => [0.577, 0.829, 0.675],
            Self::GeodesicVoxel => [0.583, 0.828, 0.678],
        };
        MeasuredL1 { organic, boxes, all }
    }

    /// The method with the least error on all validation rigs.
    pub fn best() -> Self {
        let better = |a: Self, b: Self| if b.measured().all < a.measured().all { b } else { a };
        Self::ALL.into_iter().fold(Self::RigNet, better)
    }
}

impl Default for SkinMethod {
    fn default() -> Self {
        Self::best()
    }
}

/// The method that is used, and how it came to that.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SkinChoice {
    pub method: SkinMethod,
    /// Whether the caller named the first choice.
    pub was_asked: bool,
    /// The first choice, where it cannot run here and the caller allowed another.
    pub in_place_of: Option<SkinMethod>,
}

/// The method for a job that asks for `asked` (`None`: the best), and allows `fallback` in its place, in this order. Fails where
/// none of these can run here, for the reason of the first.
pub fn choose_skin(
    asked: Option<SkinMethod>,
    fallback: &[SkinMethod],
    models: &Models,
) -> Result<SkinChoice, RigError> {
    choose(asked, fallback, |method| SkinNets::of(method, models).map(|_| ()))
}

fn choose(
    asked: Option<SkinMethod>,
    fallback: &[SkinMethod],
    can_run: impl Fn(SkinMethod) -> Result<(), RigError>,
) -> Result<SkinChoice, RigError> {
    let first = asked.unwrap_or_else(SkinMethod::best);
    let choice = SkinChoice { method: first, was_asked: asked.is_some(), in_place_of: None };
    let Err(unavailable) = can_run(first) else { return Ok(choice) };
    match fallback.iter().copied().find(|&method| can_run(method).is_ok()) {
        Some(method) => Ok(SkinChoice { method, in_place_of: Some(first), ..choice }),
        None => Err(unavailable),
    }
}

/// Why `method` cannot run here; `None` when it can.
pub fn skin_unavailable(method: SkinMethod, models: &Models) -> Option<String> {
    SkinNets::of(method, models).err().map(|error| match error {
        RigError::MethodUnavailable { reason, .. } => reason,
        other => other.to_string(),
    })
}

impl SkinChoice {
    /// One sentence for people: why this method.
    pub fn reason(&self) -> String {
        if let Some(first) = self.in_place_of {
            return format!(
                "{} is not available here, and {} was allowed in its place",
                first.name(),
                self.method.name()
            );
        }
        if self.was_asked {
            return format!("{} was asked for", self.method.name());
        }
        let MeasuredL1 { organic, boxes, all } = self.method.measured();
        let others = SkinMethod::ALL.into_iter().filter(|&method| method != self.method);
        let others: Vec<String> =
            others.map(|method| format!("{} {:.2}", method.name(), method.measured().all)).collect();
        format!(
            "{} has the least error on validation rigs: mean L1 {all:.2} (organic {organic:.2}, box models {boxes:.2}) against {}",
            self.method.name(),
            others.join(", ")
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use SkinMethod::{GeodesicHeat, GeodesicVoxel, HeterSkinNet, RigNet};

    fn without(gone: &[SkinMethod]) -> impl Fn(SkinMethod) -> Result<(), RigError> {
        let gone = gone.to_vec();
        move |method| match gone.contains(&method) {
            true => Err(RigError::MethodUnavailable { method: method.name(), reason: "it is not here".into() }),
            false => Ok(()),
        }
    }

    #[test]
    fn the_best_is_chosen_unless_another_is_asked_for() {
        let auto = choose(None, &[], without(&[])).expect("a choice");
        assert_eq!((auto.method, auto.was_asked), (SkinMethod::best(), false));
        assert!(auto.reason().contains("least error") && auto.reason().contains("rignet"), "{}", auto.reason());
        let asked = choose(Some(GeodesicHeat), &[], without(&[])).expect("a choice");
        assert_eq!((asked.method, asked.was_asked, asked.in_place_of), (GeodesicHeat, true, None));
    }

    #[test]
    fn what_is_not_here_fails_unless_another_is_allowed() {
        let error = choose(None, &[], without(&[HeterSkinNet])).expect_err("refused");
        assert!(error.to_string().contains("heter_skin_net"), "{error}");
        let gone = without(&[HeterSkinNet, RigNet]);
        let choice = choose(None, &[RigNet, GeodesicVoxel, GeodesicHeat], &gone).expect("a choice");
        assert_eq!((choice.method, choice.in_place_of), (GeodesicVoxel, Some(HeterSkinNet)));
        assert!(choice.reason().contains("was allowed in its place"), "{}", choice.reason());
        assert!(choose(None, &[RigNet], &gone).is_err());
    }
}
