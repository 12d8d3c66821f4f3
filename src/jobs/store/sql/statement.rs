//! Statements that are written once: the SQL that both engines understand, with `$1`, `$2`, … for values, which are whole
//! numbers, texts and bytes.

use crate::jobs::store::StoreFailure;
use sqlx::{SqlSafeStr, SqlStr};

/// A value as a statement takes it.
#[derive(Clone, Debug)]
pub enum Value {
    Integer(Option<i64>),
    Text(Option<String>),
    Bytes(Option<Vec<u8>>),
}

macro_rules! value_from {
    ($($from:ty => $kind:ident($make:expr),)*) => {
        $(impl From<$from> for Value {
            fn from(value: $from) -> Self {
                let make: fn($from) -> _ = $make;
                Self::$kind(make(value))
            }
        })*
    };
}

value_from! {
    i64 => Integer(Some),
    Option<i64> => Integer(|value| value),
    &str => Text(|value| Some(value.to_owned())),
    String => Text(Some),
    Option<String> => Text(|value| value),
    Option<&str> => Text(|value| value.map(str::to_owned)),
    Vec<u8> => Bytes(Some),
    Option<Vec<u8>> => Bytes(|value| value),
    [u8; 16] => Bytes(|value| Some(value.to_vec())),
    [u8; 32] => Bytes(|value| Some(value.to_vec())),
    Option<[u8; 16]> => Bytes(|value| value.map(Vec::from)),
    Option<[u8; 32]> => Bytes(|value| value.map(Vec::from)),
}

/// A statement with its values.
#[derive(Debug)]
pub struct Statement {
    pub text: SqlStr,
    pub values: Vec<Value>,
}

pub fn sql(text: impl SqlSafeStr) -> Statement {
    Statement { text: text.into_sql_str(), values: Vec::new() }
}

impl Statement {
    /// The next value.
    pub fn bind(mut self, value: impl Into<Value>) -> Self {
        self.values.push(value.into());
        self
    }

    /// How many rows it changed.
    pub async fn execute<C: Connection>(self, connection: &mut C) -> Result<u64, StoreFailure> {
        connection.execute(self).await
    }

    pub async fn all<C: Connection>(self, connection: &mut C) -> Result<Vec<C::Row>, StoreFailure> {
        connection.fetch(self).await
    }

    pub async fn optional<C: Connection>(self, connection: &mut C) -> Result<Option<C::Row>, StoreFailure> {
        Ok(connection.fetch(self).await?.into_iter().next())
    }

    pub async fn one<C: Connection>(self, connection: &mut C) -> Result<C::Row, StoreFailure> {
        let row = self.optional(connection).await?;
        row.ok_or_else(|| StoreFailure::new(&"a row that must be there is not"))
    }
}

/// What transactions agree on where an engine lets several of them write.
#[derive(Clone, Copy, Debug)]
pub enum Lock<'a> {
    /// Blobs are named or used; many may at a time, but not while some are forgotten.
    Naming,
    /// Blobs that nobody needs are forgotten.
    Forgetting,
    /// What belongs to this name is looked at and then changed.
    Name { kind: &'static str, caller: &'a str, name: &'a str },
    /// What time has brought is applied. Not waited for: whoever has it does the work.
    Upkeep,
}

/// A connection of an engine, in a transaction or not.
pub trait Connection: Send {
    type Row: Columns;

    /// After a `SELECT` whose rows will be changed in this transaction.
    const FOR_UPDATE: &'static str;
    /// The same, passing over rows that somebody else has; of the table `jobs` alone.
    const FOR_UPDATE_SKIP_LOCKED: &'static str;
    /// Notes that the caller `$1` was served just now.
    const SERVED: &'static str;

    fn execute(&mut self, statement: Statement) -> impl Future<Output = Result<u64, StoreFailure>> + Send;

    fn fetch(&mut self, statement: Statement) -> impl Future<Output = Result<Vec<Self::Row>, StoreFailure>> + Send;

    /// Takes a lock until the transaction ends. `false`: somebody else has it, and it is not waited for.
    fn lock(&mut self, lock: Lock<'_>) -> impl Future<Output = Result<bool, StoreFailure>> + Send;
}

/// A row of an engine.
pub trait Columns: Send + Sync {
    fn integer(&self, column: &str) -> Result<Option<i64>, StoreFailure>;
    fn text(&self, column: &str) -> Result<Option<&str>, StoreFailure>;
    fn bytes(&self, column: &str) -> Result<Option<&[u8]>, StoreFailure>;

    fn get<'r, T: Column<'r>>(&'r self, column: &str) -> Result<T, StoreFailure>
    where
        Self: Sized,
    {
        T::read(self, column)
    }
}

/// What a column is read as.
pub trait Column<'r>: Sized {
    fn read(row: &'r impl Columns, column: &str) -> Result<Self, StoreFailure>;
}

fn there<T>(value: Option<T>, column: &str) -> Result<T, StoreFailure> {
    value.ok_or_else(|| StoreFailure::new(&format!("{column} is empty")))
}

macro_rules! column {
    ($($target:ty: $read:ident, $make:expr;)*) => {
        $(
            impl<'r> Column<'r> for Option<$target> {
                fn read(row: &'r impl Columns, column: &str) -> Result<Self, StoreFailure> {
                    Ok(row.$read(column)?.map($make))
                }
            }

            impl<'r> Column<'r> for $target {
                fn read(row: &'r impl Columns, column: &str) -> Result<Self, StoreFailure> {
                    there(row.$read(column)?.map($make), column)
                }
            }
        )*
    };
}

column! {
    i64: integer, |value| value;
    &'r str: text, |value| value;
    String: text, str::to_owned;
    &'r [u8]: bytes, |value| value;
    Vec<u8>: bytes, <[u8]>::to_vec;
}

/// The connection and row of one engine of sqlx.
macro_rules! engine_connection {
    ($database:ty, $connection:ty, $row:ty) => {
        impl $crate::jobs::store::sql::Columns for $row {
            fn integer(&self, column: &str) -> Result<Option<i64>, StoreFailure> {
                Ok(sqlx::Row::try_get(self, column)?)
            }

            fn text(&self, column: &str) -> Result<Option<&str>, StoreFailure> {
                Ok(sqlx::Row::try_get(self, column)?)
            }

            fn bytes(&self, column: &str) -> Result<Option<&[u8]>, StoreFailure> {
                Ok(sqlx::Row::try_get(self, column)?)
            }
        }

        /// The statement as sqlx has it.
        fn query(
            statement: $crate::jobs::store::sql::Statement,
        ) -> sqlx::query::Query<'static, $database, <$database as sqlx::Database>::Arguments> {
            use $crate::jobs::store::sql::Value;
            let bare = sqlx::query::<$database>(statement.text);
            statement.values.into_iter().fold(bare, |query, value| match value {
                Value::Integer(value) => query.bind(value),
                Value::Text(value) => query.bind(value),
                Value::Bytes(value) => query.bind(value),
            })
        }
    };
}

pub(in crate::jobs::store) use engine_connection;
