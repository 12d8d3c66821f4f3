//! Names of joints, with `*` for any letters and `?` for one: how a caller names many joints at once.

/// Patterns of one option, and letters of one pattern.
pub const PATTERNS_MAX: usize = 100;
pub const PATTERN_LENGTH_MAX: usize = 200;

/// Whether `name` is what `pattern` means, letter by letter.
pub fn matches(pattern: &str, name: &str) -> bool {
    let (pattern, name): (Vec<char>, Vec<char>) = (pattern.chars().collect(), name.chars().collect());
    let (mut at, mut seen) = (0, 0);
    // Where the last star stands, and how much of the name it takes. Only the last one need ever take more.
    let mut star: Option<(usize, usize)> = None;
    while seen < name.len() {
        match pattern.get(at) {
            Some('*') => {
                star = Some((at, seen));
                at += 1;
            }
            Some(&letter) if letter == '?' || letter == name[seen] => {
                at += 1;
                seen += 1;
            }
            _ => {
                let Some((place, taken)) = star else { return false };
                star = Some((place, taken + 1));
                (at, seen) = (place + 1, taken + 1);
            }
        }
    }
    pattern[at..].iter().all(|&letter| letter == '*')
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stars_take_any_letters_and_question_marks_one() {
        for (pattern, name) in [
            ("IK_*", "IK_hand.L"),
            ("IK_*", "IK_"),
            ("*_end", "hand_end_end"),
            ("*a*b?", "xxaybbz"),
            ("hand", "hand"),
            ("*", ""),
            ("", ""),
            ("Kopf é*", "Kopf éx"),
        ] {
            assert!(matches(pattern, name), "{pattern} {name}");
        }
        for (pattern, name) in
            [("IK_*", "FK_hand"), ("hand", "hand_l"), ("?", ""), ("*_end", "end"), ("", "a"), ("Hand", "hand")]
        {
            assert!(!matches(pattern, name), "{pattern} {name}");
        }
    }
}
