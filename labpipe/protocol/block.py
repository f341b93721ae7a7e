"""What every block of a protocol and of a test sheet has in common."""

from __future__ import annotations

from typing import Any, Self

from pydantic import (
    BaseModel,
    ConfigDict,
    ModelWrapValidatorHandler,
    SerializerFunctionWrapHandler,
    ValidationError,
    model_serializer,
    model_validator,
)

from labpipe.protocol.faults import Fault, faults_of, raised


class Block(BaseModel):
    """A block of keys: frozen, closed to unknown keys, its faults told in our words."""

    # Built when first used: a test uses a protocol and a sheet, not each block on its own.
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, defer_build=True)

    @classmethod
    def keys(cls) -> list[str]:
        """List the keys as YAML writes them."""
        return [field.alias or name for name, field in cls.model_fields.items()]

    @classmethod
    def between(cls, data: object) -> list[Fault]:  # noqa: ARG003 - blocks that check use it
        """Check one part of the block against another, whether or not each part is valid.

        Parameters
        ----------
        data : the block as written

        Returns
        -------
        The faults, with their paths in `data`.
        """
        return []

    @model_validator(mode="wrap")
    @classmethod
    def _in_our_words(cls, data: object, handler: ModelWrapValidatorHandler[Self]) -> Self:
        """Collect the faults within the parts and between them; the first at a place is told.

        A key that should not be there at all is told as such, not by what is wrong with its value.
        """
        between = cls.between(data)
        within: list[Fault] = []
        try:
            block = handler(data)
        except ValidationError as error:
            within = faults_of(error, data=data, keys=cls.keys())
        else:
            if not between:
                return block
        misspelt = {fault.path for fault in between if fault.at == "key"}
        within = [fault for fault in within if fault.path not in misspelt]
        told = {fault.path for fault in within}
        raise raised([*within, *(fault for fault in between if fault.path not in told)], data)

    @model_serializer(mode="wrap")
    def _without_unset(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Leave out what is None because nobody said anything."""
        fields = type(self).model_fields
        unset = {field.alias or name for name, field in fields.items() if field.default is None}
        return {
            key: value
            for key, value in handler(self).items()
            if value is not None or key not in unset
        }
