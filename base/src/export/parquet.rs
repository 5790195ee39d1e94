//! The table of [`super::table`] as Parquet: one row group, optional columns; columns of UTC are timestamps, nanoseconds.

use super::table::{Column, Kind, columns, text};
use anyhow::Result;
use parquet::basic::{ConvertedType, LogicalType, Repetition, TimeUnit, Type as Physical};
use parquet::data_type::{BoolType, ByteArray, ByteArrayType, DataType, DoubleType, Int64Type};
use parquet::file::properties::WriterProperties;
use parquet::file::writer::{SerializedFileWriter, SerializedRowGroupWriter};
use parquet::schema::types::Type;
use serde_json::Value;
use std::io::Write;
use std::sync::Arc;
use time::OffsetDateTime;
use time::format_description::well_known::Rfc3339;

/// Writes records.
pub(super) fn write(records: &[Value], out: &mut (impl Write + Send)) -> Result<()> {
    let columns = columns(records);
    let fields = columns.iter().map(|c| Ok(Arc::new(field(c, records)?))).collect::<Result<Vec<_>>>()?;
    let schema = Arc::new(Type::group_type_builder("records").with_fields(fields).build()?);
    let mut file = SerializedFileWriter::new(out, schema, Arc::new(WriterProperties::builder().build()))?;
    let mut group = file.next_row_group()?;
    for column in &columns {
        let cells = records.iter().map(|r| r.get(column.key).filter(|v| !v.is_null()));
        match column.kind {
            Kind::Text if is_utc(column, records) => {
                put::<Int64Type>(&mut group, cells.map(|v| nanoseconds(v?)))?
            }
            Kind::Bool => put::<BoolType>(&mut group, cells.map(|v| v?.as_bool()))?,
            Kind::Integer => put::<Int64Type>(&mut group, cells.map(|v| v?.as_i64()))?,
            Kind::Number => put::<DoubleType>(&mut group, cells.map(|v| v?.as_f64()))?,
            Kind::Text | Kind::Unknown => {
                put::<ByteArrayType>(&mut group, cells.map(|v| Some(ByteArray::from(text(v)?.as_str()))))?;
            }
        }
    }
    group.close()?;
    file.close()?;
    Ok(())
}

/// Nanoseconds since 1970 of a time as records write it.
fn nanoseconds(value: &Value) -> Option<i64> {
    let time = OffsetDateTime::parse(value.as_str()?, &Rfc3339).ok()?;
    i64::try_from(time.unix_timestamp_nanos()).ok()
}

/// Whether a column is one of times: by its name, and all its values.
fn is_utc(column: &Column<'_>, records: &[Value]) -> bool {
    let mut values = records.iter().filter_map(|r| r.get(column.key)).filter(|v| !v.is_null());
    (column.key == "utc" || column.key.ends_with("_utc")) && values.all(|v| nanoseconds(v).is_some())
}

fn field(column: &Column<'_>, records: &[Value]) -> Result<Type> {
    if column.kind == Kind::Text && is_utc(column, records) {
        let builder = Type::primitive_type_builder(column.key, Physical::INT64);
        let utc = LogicalType::timestamp(true, TimeUnit::NANOS);
        return Ok(builder.with_repetition(Repetition::OPTIONAL).with_logical_type(Some(utc)).build()?);
    }
    let (physical, converted) = match column.kind {
        Kind::Bool => (Physical::BOOLEAN, ConvertedType::NONE),
        Kind::Integer => (Physical::INT64, ConvertedType::NONE),
        Kind::Number => (Physical::DOUBLE, ConvertedType::NONE),
        Kind::Text | Kind::Unknown => (Physical::BYTE_ARRAY, ConvertedType::UTF8),
    };
    let builder = Type::primitive_type_builder(column.key, physical).with_repetition(Repetition::OPTIONAL);
    Ok(builder.with_converted_type(converted).build()?)
}

/// Writes the next column; an empty cell is not defined.
fn put<T: DataType>(
    group: &mut SerializedRowGroupWriter<'_, impl Write + Send>,
    cells: impl Iterator<Item = Option<T::T>>,
) -> Result<()> {
    let (mut values, mut defined) = (Vec::new(), Vec::new());
    for cell in cells {
        defined.push(i16::from(cell.is_some()));
        values.extend(cell);
    }
    let Some(mut column) = group.next_column()? else { return Ok(()) };
    column.typed::<T>().write_batch(&values, Some(&defined), None)?;
    Ok(column.close()?)
}
