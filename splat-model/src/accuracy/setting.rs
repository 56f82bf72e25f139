//! Settings of dials, by name.

use std::collections::BTreeMap;
use std::fmt::{self, Display};
use std::str::FromStr;

use serde::{Deserialize, Serialize};
use splat_op::RenderOptions;
use thiserror::Error;

use super::dials::{DIALS, Dial, Judge};

/// Values for some of the dials; the other dials keep their values.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "BTreeMap<String, String>", into = "BTreeMap<String, String>")]
pub struct Setting(BTreeMap<&'static str, &'static str>);

/// A dial, a value or a preset that does not exist: its name, and the names that do.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("{0}")]
pub struct DialError(String);

fn names<'a>(all: impl Iterator<Item = &'a str>) -> String {
    all.collect::<Vec<_>>().join(", ")
}

impl Setting {
    /// A setting from names of dials and of their values.
    ///
    /// # Errors
    /// If a dial or a value does not exist.
    pub fn new<'a>(turned: impl IntoIterator<Item = (&'a str, &'a str)>) -> Result<Self, DialError> {
        let mut setting = Self::default();
        for (name, value) in turned {
            let dial = Dial::named(name).ok_or_else(|| {
                let known = names(DIALS.iter().map(|dial| dial.name));
                DialError(format!("there is no dial {name:?}; the dials are {known}"))
            })?;
            let found = dial.value(value).ok_or_else(|| {
                let known = names(dial.values.iter().map(|value| value.name));
                DialError(format!("the dial {} has no value {value:?}; its values are {known}", dial.name))
            })?;
            setting.0.insert(dial.name, found.name);
        }
        Ok(setting)
    }

    /// The dials that differ between `from` and `to`, at their values in `to`. Dials whose value in `to` is not listed are left out.
    pub fn between(from: &RenderOptions, to: &RenderOptions) -> Self {
        let turned = DIALS.iter().filter_map(|dial| {
            let value = dial.value_in(to)?;
            ((value.set)(*from) != *from).then_some((dial.name, value.name))
        });
        Self(turned.collect())
    }

    /// `options` with these dials set.
    pub fn apply(&self, options: RenderOptions) -> RenderOptions {
        self.values().fold(options, |options, (_, value)| (value.set)(options))
    }

    /// The dials of both settings. Values of `other` take precedence.
    pub fn and(mut self, other: &Self) -> Self {
        self.0.extend(&other.0);
        self
    }

    /// The dials and their values, in the order of the dials' names.
    pub fn values(&self) -> impl Iterator<Item = (&'static Dial, &'static super::DialValue)> {
        self.0.iter().filter_map(|(name, value)| {
            let dial = Dial::named(name)?;
            Some((dial, dial.value(value)?))
        })
    }

    /// Whether no dial is set.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// The reference that the setting is judged against: photographs as soon as it holds a model choice.
    pub fn judge(&self) -> Judge {
        let choices = self.values().any(|(dial, _)| dial.judge == Judge::Photographs);
        if choices { Judge::Photographs } else { Judge::Exact }
    }
}

impl Display for Setting {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.is_empty() {
            return f.write_str("nothing turned");
        }
        f.write_str(&self.0.iter().map(|(dial, to)| format!("{dial} {to}")).collect::<Vec<_>>().join(", "))
    }
}

impl TryFrom<BTreeMap<String, String>> for Setting {
    type Error = DialError;

    fn try_from(turned: BTreeMap<String, String>) -> Result<Self, DialError> {
        Self::new(turned.iter().map(|(dial, value)| (dial.as_str(), value.as_str())))
    }
}

impl From<Setting> for BTreeMap<String, String> {
    fn from(setting: Setting) -> Self {
        setting.0.into_iter().map(|(dial, value)| (dial.into(), value.into())).collect()
    }
}

named! {
    /// The presets of [`RenderOptions`] by name.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
    #[serde(rename_all = "kebab-case")]
    pub enum Preset {
        /// [`RenderOptions::fast`].
        Fast = "fast",
        /// [`RenderOptions::standard`].
        #[default]
        Standard = "standard",
        /// [`RenderOptions::exact`].
        Exact = "exact",
    }
}

impl Preset {
    /// The options of the preset.
    pub const fn options(self) -> RenderOptions {
        match self {
            Self::Fast => RenderOptions::fast(),
            Self::Standard => RenderOptions::standard(),
            Self::Exact => RenderOptions::exact(),
        }
    }

    /// The dials that differ from the standard.
    pub fn setting(self) -> Setting {
        Setting::between(&RenderOptions::standard(), &self.options())
    }
}

impl FromStr for Preset {
    type Err = DialError;

    fn from_str(text: &str) -> Result<Self, DialError> {
        let unknown = || DialError(format!("there is no accuracy {text:?}, expected fast, standard or exact"));
        Self::ALL.into_iter().find(|preset| preset.name() == text).ok_or_else(unknown)
    }
}

#[cfg(test)]
mod tests;
