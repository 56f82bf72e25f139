//! Records: the inputs of an operation as named fields of one generic type.

/// Declares a record. Its fields hold tensors of a backend, slices, device buffers, flags for the gradients that are wanted, or
/// the gradients, so that one form converts to another by a map instead of a list of fields.
///
/// The gradient of an input is the field of the same name and has the input's shape.
macro_rules! record {
    ($(#[$meta:meta])* $vis:vis struct $name:ident { $($(#[$field_meta:meta])* $field:ident,)* }) => {
        $(#[$meta])*
        #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
        $vis struct $name<T> {
            $($(#[$field_meta])* pub $field: T,)*
        }

        #[allow(dead_code, reason = "no record uses all of them")]
        impl<T> $name<T> {
            /// Applies `f` to each field.
            pub fn map<U>(self, mut f: impl FnMut(T) -> U) -> $name<U> {
                $name { $($field: f(self.$field),)* }
            }

            /// Returns references to the fields.
            pub fn each_ref(&self) -> $name<&T> {
                $name { $($field: &self.$field,)* }
            }

            /// Returns mutable references to the fields.
            pub fn each_mut(&mut self) -> $name<&mut T> {
                $name { $($field: &mut self.$field,)* }
            }

            /// Pairs each field with the same field of another record.
            pub fn zip<U>(self, other: $name<U>) -> $name<(T, U)> {
                $name { $($field: (self.$field, other.$field),)* }
            }

            /// Returns the fields in the order of their declaration.
            pub fn into_array(self) -> [T; [$(stringify!($field)),*].len()] {
                [$(self.$field,)*]
            }

            /// Creates a record from fields in the order of their declaration.
            pub fn from_array(fields: [T; [$(stringify!($field)),*].len()]) -> Self {
                let [$($field,)*] = fields;
                Self { $($field,)* }
            }
        }
    };
}

pub(crate) use record;
